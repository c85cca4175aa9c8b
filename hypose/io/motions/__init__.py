"""Motions, bodies and results, in and out."""
