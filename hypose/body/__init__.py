"""The body: joint tree, mesh, ready models, and the Motion every tracker returns."""
