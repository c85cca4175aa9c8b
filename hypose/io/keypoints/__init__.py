"""Reading of 2D key points of detectors, and access to detectors."""
