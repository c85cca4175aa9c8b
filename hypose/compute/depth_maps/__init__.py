"""Bodies against depth maps: what hypotheses cost."""
