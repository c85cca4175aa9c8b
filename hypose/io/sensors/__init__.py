"""Reading of depth sensors' files: skeletons and depth maps."""
