"""Tracking: silhouettes and key points of several cameras in, a Motion of the articulated body out."""
