"""Compute: the only room that imports numba (or CUDA); every hot function takes and returns arrays."""
