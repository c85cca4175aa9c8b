"""Fusion: one skeleton out of the skeletons of several depth sensors, with its uncertainty."""
