"""The body: joint tree, mesh, ready models, and the motion that every tracker returns."""
