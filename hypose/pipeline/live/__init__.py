"""Track people live from cameras; sockets and pages are in hypose.app."""
