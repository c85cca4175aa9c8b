"""Evidence: what is measured in images, and how it is measured."""
