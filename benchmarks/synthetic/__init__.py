"""Scenes, captured motion and faults that benchmarks and tests make, and no user's recording needs."""
