"""Monocular 3D tracking of a person with several hypotheses (Sminchisescu & Triggs 2001), as a recipe of the tracker.

recipe.py puts the layers together and solves a whole clip, picture_search.py holds the layers, pool.py their
candidates, initialise.py finds the first hypotheses, settings.py holds the options and the estimated dof.
"""
