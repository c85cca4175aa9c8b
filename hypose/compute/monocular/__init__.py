"""Evidence and search of one camera."""
