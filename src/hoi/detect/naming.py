"""Name the object of a photo that nobody named, by what the box detector sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hoi.artifacts import Hints
from hoi.detect.backends import BoxDetector
from hoi.detect.boxes import overlap
from hoi.detect.choice import NO_HINTS
from hoi.detect.config import DetectConfig
from hoi.detect.finding import PairFinder
from hoi.detect.labels import AUTO, PERSON, label_weights
from hoi.detect.models import require_models

_SAME_BOX = 0.4  # IoU from which a detection names what the user drew


class ObjectNamer:
    """Says which category a photo's object is of.

    Args:
        config: thresholds, labels and the rule's numbers.
        categories: the categories with exemplars; the first that claims a detector class as its
            own gets it.
        models_dir: folder of the detector's files.
        box_detectors: other implementations, by default NanoDet and SSD.
    """

    def __init__(
        self,
        config: DetectConfig,
        categories: Sequence[str],
        models_dir: Path | str | None = None,
        *,
        box_detectors: Mapping[str, BoxDetector] | None = None,
    ):
        if box_detectors is None:
            from hoi.detect.stage import registry_detectors

            box_detectors = registry_detectors(config, require_models(models_dir, "all"))
        self._find = PairFinder(config.for_category(AUTO), box_detectors)
        self._category = category_of_label(categories, config.labels)

    def __call__(self, image: np.ndarray, hints: Hints = NO_HINTS) -> str | None:
        """The category of the object next to the person; None when none is seen for sure.

        A class that none of the categories claims is the answer as it is, so that a later status
        can say what it is that has no exemplars. A box that the user drew is named by the surest
        detection that it overlaps.
        """
        _, choice = self._find(
            image,
            None,
            AUTO,
            label_weights(AUTO, {}, 1.0),
            hints=hints.model_copy(update={"object_box": None}),
        )
        label = choice.object.label if choice.object else None
        if hints.object_box is not None:
            drawn, seen = hints.object_box, choice.candidates
            inside = [c for c in seen if c.label != PERSON and overlap(c.box, drawn) >= _SAME_BOX]
            label = max(inside, key=lambda item: item.score).label if inside else None
        return None if label is None else self._category.get(label, label)


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
