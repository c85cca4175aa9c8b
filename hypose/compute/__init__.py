"""Compute: the only room whose code numba compiles; every hot function takes and returns arrays.

A kernel is a function under `compiled.kernel`; public functions here check and tidy arrays, call kernels and spread
work over threads. Other rooms import the module that they use.
"""
