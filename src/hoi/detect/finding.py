"""The boxes of one person and one object in a photo: look, look closer, choose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hoi.artifacts import Hints
from hoi.detect.backends import Box, BoxDetector, DetectedBox
from hoi.detect.boxes import longer_side, overlap, pixel_window
from hoi.detect.choice import CHOSEN, NO_HINTS, Choice, choose
from hoi.detect.config import DetectConfig
from hoi.detect.labels import OWN, PERSON, USER

#: Scores of the second look are for the same boxes: one that is there already adds nothing.
_SAME_BOX = 0.5


class PairFinder:
    """Finds a person and an object of the wanted classes with a box detector."""

    def __init__(self, config: DetectConfig, detector: BoxDetector):
        self.config = config
        self._detector = detector

    def __call__(
        self,
        image: np.ndarray,
        weights: dict[str, float],
        own_person: Box | None = None,
        own_object: Box | None = None,
        config: DetectConfig | None = None,
        hints: Hints = NO_HINTS,
    ) -> tuple[list[DetectedBox], Choice]:
        """Boxes of the whole picture, and of the person's surroundings if that finds no object.

        Args:
            image: (H, W, 3) uint8.
            weights: wanted detector classes, see :func:`hoi.detect.labels.label_weights`.
            own_person, own_object: boxes that are known, and taken instead of detected ones.
            config: other thresholds than those of this finder.
            hints: what the user said; masks go before its boxes.
        """
        config = config or self.config
        own_person = own_person or hints.person_box
        own_object = own_object or hints.object_box
        if own_person is not None:
            hints = hints.model_copy(update={"person": None, "person_point": None})
        if own_object is not None:
            hints = hints.model_copy(update={"object_point": None})
        if own_object is not None:
            weights = {OWN: 1.0}
        boxes = [] if own_person and own_object else self._detector(image)
        if own_person is not None:
            boxes = [item for item in boxes if item.label != PERSON]
            boxes.append(DetectedBox(PERSON, 1.0, own_person, USER))
        if own_object is not None:
            boxes.append(DetectedBox(OWN, 1.0, own_object, USER))
        choice = choose(boxes, weights, config, hints)
        if choice.person is None or choice.object is not None:
            return boxes, choice
        if own_object is not None:  # the rule doubts it, its owner does not
            verdicts = (*choice.verdicts[:-1], CHOSEN)
            return boxes, replace(choice, object=boxes[-1], verdicts=verdicts)
        if (weights or hints.object_point) and config.nanodet.crop_pass:
            boxes = boxes + self._second_look(image, choice.person.box, boxes)
            choice = choose(boxes, weights, config, hints)
        return boxes, choice

    def _second_look(
        self, image: np.ndarray, person: Box, seen: list[DetectedBox]
    ) -> list[DetectedBox]:
        """Objects, in image pixels, that show up in a square around the person."""
        x, y = (person[0] + person[2]) / 2, (person[1] + person[3]) / 2
        half = self.config.nanodet.crop_margin * longer_side(person) / 2
        rows, columns = pixel_window((x - half, y - half, x + half, y + half), *image.shape[:2])
        left, top = columns.start, rows.start
        found = []
        for item in self._detector(image[rows, columns]):
            x0, y0, x1, y1 = item.box
            box = (x0 + left, y0 + top, x1 + left, y1 + top)
            known = any(
                item.label == other.label
                and item.score <= other.score
                and overlap(box, other.box) > _SAME_BOX
                for other in seen
            )
            if item.label != PERSON and not known:
                found.append(DetectedBox(item.label, item.score, box))
        return found
