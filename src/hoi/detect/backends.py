"""What a detection back end is: four small roles, one file for each implementation.

Images are RGB (H, W, 3) uint8, boxes are x0, y0, x1, y1 in pixels, masks are (H, W) bool. An
implementation is a pure function of its arguments and raises FrameFailure for a picture it cannot
handle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class DetectedBox:
    """One box with its class, score in [0, 1] and who saw it."""

    label: str
    score: float
    box: Box
    source: str = ""


@dataclass(frozen=True)
class PersonPose:
    """What a pose model sees of one person; rows in the order of ``hoi.body.keypoints.KEYPOINTS``.

    `keypoints` (21, 3): x, y in pixels and confidence. `landmarks` (21, 3): metres, hip-centred,
    camera axes (x right, y down, z forward). `probability` (H, W): of a pixel to be this person.
    """

    keypoints: np.ndarray
    landmarks: np.ndarray
    probability: np.ndarray
    score: float


class BoxDetector(Protocol):
    """Finds people and objects."""

    def __call__(self, image: np.ndarray) -> list[DetectedBox]: ...


class PoseEstimator(Protocol):
    """Reads one person's pose; None when there is nobody in the box. `intrinsics` is K (3, 3)."""

    def __call__(
        self, image: np.ndarray, box: Box, intrinsics: np.ndarray
    ) -> PersonPose | None: ...


class ObjectSegmenter(Protocol):
    """Turns an object's box into a mask, and says in one word how."""

    def __call__(
        self, image: np.ndarray, box: Box, pose: PersonPose, seed: int
    ) -> tuple[np.ndarray, str]: ...


class ThingInUse(Protocol):
    """Guesses which pixels show what a person uses, told neither where it is nor what.

    `extent`: about how many pixels long such a thing looks; None when unknown. `held`: it is small
    and in the hands, if anywhere.
    """

    def __call__(
        self, image: np.ndarray, person: Box, pose: PersonPose, extent: float | None, held: bool
    ) -> np.ndarray:
        """(H, W) probability."""
        ...
