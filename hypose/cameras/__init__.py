"""Cameras: pinhole with lens distortion, and rigs of them."""
