"""Reconstruct people and the objects they use, in 3D, from one photo.

One package per stage of the paper (detect, smplify, objectfit, actions, priors, joint, evaluate);
stages meet only in the artifacts of :mod:`hoi.artifacts`. Shared ground: geometry, rendering,
body, exemplars, datasets.
"""

__version__ = "0.1.0"
