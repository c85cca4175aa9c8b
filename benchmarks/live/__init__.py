"""Live tracking from virtual cameras, everything on this computer."""
