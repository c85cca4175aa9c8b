"""Benchmarks of several people: who is who across views and time."""
