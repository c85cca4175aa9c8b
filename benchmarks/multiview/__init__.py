"""Benchmarks of tracking with several cameras, and of the bodies it tracks with."""
