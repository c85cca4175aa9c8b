"""Benchmarks of gestures in depth pictures."""
