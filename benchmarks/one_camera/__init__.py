"""Benchmarks of tracking with one camera."""
