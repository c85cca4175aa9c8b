"""Core of the search that all trackers share: weighted hypotheses, kernels, weights, resampling.
It works on arrays only and does not depend on images or on a body model.
"""
