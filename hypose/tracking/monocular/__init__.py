"""Monocular 3D tracking of a person with several hypotheses (Sminchisescu & Triggs 2001).

types.py says what goes in and comes out, settings.py what can be chosen, tracker.py follows a person from frame to
frame, clip.py puts the frames of a whole clip together, models.py has the degrees of freedom that are estimated.
"""
