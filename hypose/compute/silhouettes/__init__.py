"""Silhouettes of posed meshes against masks."""
