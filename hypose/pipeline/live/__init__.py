"""Cameras in, poses out, while it happens: nothing here knows a socket or a page."""
