"""Name the object of a photo that nobody named, by what the box detector sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hoi.detect.backends import BoxDetector
from hoi.detect.config import DetectConfig
from hoi.detect.finding import PairFinder
from hoi.detect.labels import AUTO, label_weights
from hoi.detect.models import require_models


class ObjectNamer:
    """Says which category a photo's object is of.

    Args:
        config: thresholds, labels and the rule's numbers.
        categories: the categories with exemplars; the first that claims a detector class as its
            own gets it.
        models_dir: folder of the detector's files.
        box_detector: another implementation, by default NanoDet.
    """

    def __init__(
        self,
        config: DetectConfig,
        categories: Sequence[str],
        models_dir: Path | str | None = None,
        *,
        box_detector: BoxDetector | None = None,
    ):
        if box_detector is None:
            from hoi.detect.nanodet import NanoDet

            box_detector = NanoDet(config.nanodet, require_models(models_dir, "all"))
        self._find = PairFinder(config.for_category(AUTO), box_detector)
        self._category = category_of_label(categories, config.labels)

    def __call__(self, image: np.ndarray) -> str | None:
        """The category of the object next to the person; None when none is seen for sure.

        A class that none of the categories claims is the answer as it is, so that a later status
        can say what it is that has no exemplars.
        """
        _, choice = self._find(image, label_weights(AUTO, {}, 1.0))
        if choice.object is None:
            return None
        return self._category.get(choice.object.label, choice.object.label)


def category_of_label(
    categories: Sequence[str], overrides: Mapping[str, tuple[str, ...]]
) -> dict[str, str]:
    """Detector class -> the first of `categories` whose own class it is, look-alikes aside."""
    found: dict[str, str] = {}
    for category in categories:
        for label, weight in label_weights(category, overrides, 0.5).items():
            if weight == 1.0:
                found.setdefault(label, category)
    return found
