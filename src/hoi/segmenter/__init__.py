"""The object segmenter: a small network that turns a box and a person mask into an object mask.

:mod:`~hoi.segmenter.runtime` runs the shipped weights with OpenCV. The other modules are the
recipe that made them: meshes, rendered scenes, crops, training, export, evaluation; see
``docs/segmenter.md``.
"""
