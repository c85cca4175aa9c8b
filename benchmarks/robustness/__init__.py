"""Benchmarks of what goes wrong: kills, faults, full disks, many recordings."""
