"""Benchmarks of calibration, its doctor, and clocks."""
