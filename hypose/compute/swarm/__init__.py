"""Fused skeletons: swarm, fit, fuzzy rules."""
