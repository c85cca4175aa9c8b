"""The spine that every tracker shares: weighted hypotheses, kernels, weights, selection. Arrays only, no
images, no body.
"""
