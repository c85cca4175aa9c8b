"""2D key points of detectors."""
