"""Monocular 3D tracking of a person with several hypotheses (Sminchisescu & Triggs 2001), as a recipe of the tracker.

recipe.py puts the layers together, picture_search.py has them, pool.py their candidates, clip.py solves a whole clip,
initialise.py finds the first hypotheses, settings.py says what can be chosen, models.py which dof are estimated.
"""
