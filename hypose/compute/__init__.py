"""Compute: the only package whose code numba compiles; its functions take and return arrays.

A kernel is a function decorated with `compiled.kernel`. Public functions check and convert arrays, call kernels, and
spread work over threads. Other packages import the module that they use.
"""
