"""Files of depth sensors: skeletons and depth."""
