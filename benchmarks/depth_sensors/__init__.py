"""Benchmarks of fused skeletons."""
