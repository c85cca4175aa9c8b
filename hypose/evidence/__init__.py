"""Evidence: the measurement in images, and how it is measured."""
