"""Synthetic scenes with known truth (bodies, motions, rendering, sensors, faults), and measures that
compare with it.
"""
