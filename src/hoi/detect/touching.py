"""How near a box is to where the person could touch it, and whether it has the object's size.

Both are judged in metres at the person's distance, which the pose gives: the size of its 3D
landmarks over their size in the picture. Contact does not need depth here, as an object that
touches is as far away as the person.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from hoi.body.keypoints import KEYPOINT
from hoi.detect.backends import Box, PersonPose
from hoi.detect.boxes import longer_side
from hoi.detect.config import TouchConfig
from hoi.detect.labels import SIZE_TABLE
from hoi.errors import AssetError

HANDS, SEAT, BACK, FEET = "hands", "seat", "back", "feet"
BOTH_HANDS = "both_hands"  # as near as the farther hand: what is typed on or carried level
_BY_HAND = {HANDS, BOTH_HANDS}
_ANYWHERE = (HANDS, SEAT, BACK, FEET)
_HAND_LENGTH = 0.35  # of the forearm, beyond the wrist


@dataclass(frozen=True)
class Expectation:
    """What is known of a category: its longest extent in metres, and what touches it."""

    shortest_m: float
    longest_m: float
    touches: tuple[str, ...]


def expectation(category: str) -> Expectation | None:
    """The row of the table, None for a category that it does not have."""
    return _table().get(category)


@cache
def _table() -> dict[str, Expectation]:
    table = {}
    with SIZE_TABLE.open(newline="") as stream:
        for row in csv.DictReader(stream):
            touches = tuple(row["touches"].split())
            low, high = float(row["shortest_m"]), float(row["longest_m"])
            if not (0 < low < high and touches and set(touches) <= {*_ANYWHERE, BOTH_HANDS}):
                raise AssetError(f"{SIZE_TABLE}: bad row {row}")
            table[row["category"]] = Expectation(low, high, touches)
    return table


@dataclass(frozen=True)
class TouchPoints:
    """Where one person can touch things: (x, y) pixels by body part, and pixels per metre."""

    points: dict[str, np.ndarray]  # each (n, 2)
    pixels_per_metre: float


def touch_points(pose: PersonPose, person: Box, config: TouchConfig) -> TouchPoints:
    """Hands, seat, back and feet of a pose; guessed joints count like seen ones."""
    at = {name: pose.keypoints[index, :2].astype(float) for name, index in KEYPOINT.items()}

    def hand(side: str) -> np.ndarray:
        wrist = at[f"{side}_wrist"]
        return wrist + _HAND_LENGTH * (wrist - at[f"{side}_elbow"])

    hips = (at["left_hip"] + at["right_hip"]) / 2
    shoulders = (at["left_shoulder"] + at["right_shoulder"]) / 2
    return TouchPoints(
        {
            HANDS: np.array([hand("left"), hand("right")]),
            SEAT: hips[None],
            BACK: ((hips + shoulders) / 2)[None],
            FEET: np.array([(at[f"{s}_heel"] + at[f"{s}_toe"]) / 2 for s in ("left", "right")]),
        },
        pixels_per_metre(pose, person, config),
    )


def pixels_per_metre(pose: PersonPose, person: Box, config: TouchConfig) -> float:
    """Least-squares scale of the seen landmarks' x and y to the keypoints'.

    Falls back on the box and a person's usual height where the pose says nothing.
    """
    seen = pose.keypoints[:, 2] >= config.visible
    if seen.sum() >= config.minimum_points:
        flat = pose.landmarks[seen, :2].astype(float)
        there = pose.keypoints[seen, :2].astype(float)
        flat, there = flat - flat.mean(0), there - there.mean(0)
        spread = (flat**2).sum()
        scale = np.sqrt((there**2).sum() / spread) if spread > config.minimum_spread_m2 else 0.0
        if scale > 0:
            return float(scale)
    return longer_side(person) / config.person_height_m


def distance_m(box: Box, touch: TouchPoints, parts: Sequence[str]) -> tuple[float, str]:
    """Metres from the nearest of the body parts to the box, 0 inside, and which part it is."""
    found = []
    for part in parts:
        points = touch.points[HANDS if part == BOTH_HANDS else part]
        outside = np.maximum(np.maximum(box[:2] - points, points - box[2:]), 0)
        away = np.linalg.norm(outside, axis=1)
        found.append((float(away.max() if part == BOTH_HANDS else away.min()), part))
    pixels, part = min(found)
    return pixels / touch.pixels_per_metre, part


def usual_extent(category: str, pose: PersonPose, person: Box, config: TouchConfig) -> float | None:
    """Pixels that a category's things are long at the person's distance; None when unknown."""
    known = expectation(category)
    if known is None:
        return None
    middle = (known.shortest_m * known.longest_m) ** 0.5
    return middle * pixels_per_metre(pose, person, config)


def held(category: str, longest_m: float) -> bool:
    """Whether things of a category are no longer than that and touched with the hands alone."""
    known = expectation(category)
    return known is not None and known.longest_m <= longest_m and set(known.touches) <= _BY_HAND


def between_hands(pose: PersonPose) -> np.ndarray:
    """(2,) x, y of the middle between both wrists."""
    wrists = [KEYPOINT["left_wrist"], KEYPOINT["right_wrist"]]
    return pose.keypoints[wrists, :2].mean(0)


def nearness(distance: float, config: TouchConfig) -> float:
    """1 at contact, falling to a floor: (0, 1]."""
    floor = config.far_weight
    return floor + (1 - floor) * float(np.exp(-((distance / config.distance_m) ** 2)))


def plausible_size(box: Box, touch: TouchPoints, known: Expectation, config: TouchConfig) -> float:
    """1 for a box as long as the category's things, less beyond some tolerance: (0, 1].

    Partly hidden or seen end on, a thing looks shorter; boxes are loose, so it may look longer.
    """
    extent = max(longer_side(box), 1.0) / touch.pixels_per_metre
    short = np.log(known.shortest_m * config.hidden / extent)
    long = np.log(extent / (known.longest_m * config.loose))
    return float(np.exp(-((max(short, long, 0.0) / config.size_tolerance) ** 2)))
