"""Stronger models than the ones that come with the registry, for who has them installed.

Instance segmentation replaces boxes and masks; a model that is asked with a box replaces the
object's mask. Each lives in one file, imports its library only when it is loaded, and is chosen
by `DetectConfig.strong`; :mod:`hoi.detect.strong.selection` says what ``auto`` finds.
"""
