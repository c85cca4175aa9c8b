"""Data files of the ready bodies: the tracker's template and the test subjects (see LICENSE-assets.md)."""
