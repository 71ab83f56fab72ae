"""What the models of the pipeline see in a rendered picture: the person's mask, boxes of things.

Training shows the network these, with their real faults.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hoi.detect.backends import Box, BoxDetector, DetectedBox
from hoi.detect.boxes import longer_side, middle, overlaps, pixel_window, shifted, square
from hoi.detect.labels import PERSON

_KEPT = 3  # of the boxes around a thing, those that fit it best
_LEAST_FIT = 0.4  # IoU with its tight box that these have at least
_SURROUNDINGS = 1.5  # side of the square around the person / longer side of its box


@dataclass(frozen=True, eq=False)
class Seen:
    """`person` (H, W): probability of the person, None where it sees nobody; `boxes` of things."""

    person: np.ndarray | None
    boxes: list[Box]


#: RGB picture and the box of its person, if there is one -> what is seen
Onlooker = Callable[[np.ndarray, Box | None], Seen]


def detected_around(
    detector: BoxDetector, image: np.ndarray, person: Box | None
) -> list[DetectedBox]:
    """Everything that is detected in the picture and in the person's surroundings."""
    seen = list(detector(image))
    if person is None:
        return seen
    around = square(middle(person), _SURROUNDINGS * longer_side(person))
    rows, columns = pixel_window(around, *image.shape[:2])
    left, top = columns.start, rows.start
    for item in detector(np.ascontiguousarray(image[rows, columns])):
        seen.append(replace(item, box=shifted(item.box, left, top)))
    return seen


def boxes_of_things(seen: list[DetectedBox]) -> list[Box]:
    """All boxes but those of people."""
    return [item.box for item in seen if item.label != PERSON]


def fitting_boxes(boxes: list[Box], things: list[Box]) -> list[tuple[Box, ...]]:
    """For each thing, the detected boxes that fit it best and fit no other thing better.

    Args:
        things: their tight boxes.
    """
    if not boxes:
        return [()] * len(things)
    drawn = np.array(boxes)
    fits = overlaps(drawn, np.array(things))
    found = []
    for number in range(len(things)):
        fit = np.where(fits.argmax(1) == number, fits[:, number], 0)
        best = fit.argsort()[::-1][:_KEPT]
        kept = drawn[best[fit[best] >= _LEAST_FIT]].round(1)
        found.append(tuple(tuple(box) for box in kept.tolist()))
    return found


def registry_onlooker(models_dir: Path) -> Onlooker:
    """NanoDet, and BlazePose as it will be used on photos, in its quicker size.

    Args:
        models_dir: folder with the models' files.
    """
    from hoi.detect.blazepose import BlazePose
    from hoi.detect.config import BlazePoseConfig, NanoDetConfig
    from hoi.detect.nanodet import NanoDet

    pose = BlazePose(BlazePoseConfig(complexity="full", passes=1), models_dir)
    detector = NanoDet(NanoDetConfig(), models_dir)

    def look(image: np.ndarray, person: Box | None) -> Seen:
        boxes = boxes_of_things(detected_around(detector, image, person))
        if person is None:
            return Seen(None, boxes)
        side = float(image.shape[0])
        intrinsics = np.array([[side, 0, side / 2], [0, side, side / 2], [0, 0, 1.0]])
        found = pose(image, person, intrinsics)
        return Seen(None if found is None else found.probability, boxes)

    return look
