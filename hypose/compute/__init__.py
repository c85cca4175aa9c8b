"""Compute: the only package whose code numba compiles; its functions take and return arrays.

A kernel is a function decorated with `compiled.kernel`. Public functions check and convert arrays, call kernels, and
spread work over threads. Other packages import the module that they use.
In docstrings of kernels f4 and f8 are float32 and float64, i1 to i8 whole numbers of 1 to 8 bytes with a sign, u1 to u8
those without. "About the root" means relative to the root's position, with axes as in the world.
"""
