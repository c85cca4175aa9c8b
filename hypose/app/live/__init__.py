"""Skeletons and gestures while they happen: sockets in and out."""
