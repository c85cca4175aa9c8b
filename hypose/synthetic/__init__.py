"""Scenes with known truth (bodies, motions, rendering, sensors, faults), and the measures that compare with it."""
