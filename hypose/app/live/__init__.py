"""Serve live skeletons and gestures: sockets in and out."""
