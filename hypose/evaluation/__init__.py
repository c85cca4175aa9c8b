"""Scenes with known truth, and the measures that compare an estimate with it."""
