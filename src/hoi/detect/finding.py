"""The boxes of one person and one object in a photo: look, look closer, choose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hoi.artifacts import Hints
from hoi.detect.backends import (
    Box,
    BoxDetector,
    DetectedBox,
    PersonPose,
    PoseEstimator,
    ThingInUse,
)
from hoi.detect.boxes import longer_side, middle, pixel_window, shifted, square
from hoi.detect.choice import NO_HINTS, Choice, Scene, choose, holds, plainest, screen_people
from hoi.detect.config import DetectConfig
from hoi.detect.evidence import Look, Proposal, propose
from hoi.detect.labels import OWN, PERSON, USER
from hoi.detect.touching import between_hands, expectation, held, usual_extent

_WHOLE = "whole picture"


class PairFinder:
    """Finds a person and an object of the wanted classes.

    Args:
        config: every threshold.
        detectors: box detectors by name. People are those of the first one; of the next one where
            the first sees nobody.
        pose: reads the poses that say where people could touch things; without it the distance
            between boxes must do.
        in_use: says what a person whose pose is known uses; without it every place may be that.
    """

    def __init__(
        self,
        config: DetectConfig,
        detectors: Mapping[str, BoxDetector],
        pose: PoseEstimator | None = None,
        in_use: ThingInUse | None = None,
    ):
        self.config = config
        self._detectors = dict(detectors)
        self._pose = pose
        self._in_use = in_use

    def __call__(
        self,
        image: np.ndarray,
        intrinsics: np.ndarray | None,
        category: str,
        weights: dict[str, float],
        own_person: Box | None = None,
        own_object: Box | None = None,
        config: DetectConfig | None = None,
        hints: Hints = NO_HINTS,
    ) -> tuple[list[DetectedBox], Choice]:
        """Every person's box, and the choice.

        Args:
            image: (H, W, 3) uint8.
            intrinsics: (3, 3), for the pose model.
            category: the object's noun, for what is known of such things.
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
        hints = hints.model_copy(update={"object_box": own_object})
        if own_object is not None:
            hints = hints.model_copy(update={"object_point": None})
        looks = [] if own_person and own_object else self._look(image, _WHOLE, None)
        people = self._people(looks, own_person, config)
        verdicts = screen_people(people, config, hints)
        scenes = []
        for index in plainest(people, verdicts, config.max_people):
            pose = None
            if self._pose is not None and intrinsics is not None:
                pose = self._pose(image, people[index].box, intrinsics)
            if own_object is not None:
                drawn = DetectedBox(OWN, 1.0, own_object, USER)
                places = [Proposal(drawn, 1.0, 0, unnamed=False)]
            else:
                places = self._places(
                    image, looks, people[index].box, pose, category, weights, config, hints
                )
            used = None
            if self._in_use is not None and pose is not None and len(places) > 1:
                extent = usual_extent(category, pose, people[index].box, config.touch)
                at_hands = held(category, config.looks.small_m)
                used = self._in_use(image, people[index].box, pose, extent, at_hands)
                if used.max() <= config.segmenter.threshold:  # sees no such thing
                    used = None
            scenes.append(Scene(people[index], pose, tuple(places), used))
        unplaced: list[Proposal] = []
        if not scenes:
            unplaced = propose(looks, weights, config.evidence, image.shape[:2])
        return people, choose(people, verdicts, scenes, category, config, hints, unplaced)

    def _people(
        self, looks: list[Look], own: Box | None, config: DetectConfig
    ) -> list[DetectedBox]:
        if own is not None:
            return [DetectedBox(PERSON, 1.0, own, USER)]
        found: list[DetectedBox] = []
        for look in looks:
            people = [item for item in look.boxes if item.label == PERSON]
            found += people
            if any(item.score >= config.person_threshold for item in people):
                break
        return found

    def _look(self, image: np.ndarray, where: str, window: Box | None) -> list[Look]:
        """One look of every detector at a part of the image."""
        left = top = 0
        if window is not None:
            rows, columns = pixel_window(window, *image.shape[:2])
            left, top = columns.start, rows.start
            image = image[rows, columns]
            if min(image.shape[:2]) < 2:
                return []
        looks = []
        for name, detector in self._detectors.items():
            boxes = tuple(
                replace(item, box=shifted(item.box, left, top), source=f"{name}, {where}")
                for item in detector(image)
            )
            looks.append(Look(f"{name}, {where}", boxes, window))
        return looks

    def _places(
        self,
        image: np.ndarray,
        looks: list[Look],
        person: Box,
        pose: PersonPose | None,
        category: str,
        weights: dict[str, float],
        config: DetectConfig,
        hints: Hints,
    ) -> list[Proposal]:
        """Where the object of one person may be, by looks at the picture and around the person."""
        if not weights and hints.object_point is None:
            return []
        looks = list(looks)
        for where, window in _windows(person, pose, category, config):
            looks += self._look(image, where, window)
        size = image.shape[:2]
        places = propose(looks, weights, config.evidence, size)
        point = hints.object_point
        if point is None or any(holds(p.seen.box, point) and not p.unnamed for p in places):
            return places
        labels = {item.label for look in looks for item in look.boxes} - {PERSON}
        return propose(looks, dict.fromkeys(labels, 1.0), config.evidence, size)


def _windows(
    person: Box, pose: PersonPose | None, category: str, config: DetectConfig
) -> list[tuple[str, Box]]:
    """Names and boxes of the squares to look at again."""
    side = longer_side(person)
    centre = middle(person)
    known, looks = expectation(category), config.looks
    small = known is not None and known.longest_m <= looks.small_m
    at_hands = between_hands(pose) if small and pose is not None and looks.hands else None
    windows = [
        (f"around person x{share:g}", square(centre, share * side))
        for share in (looks.around if at_hands is None else looks.around_small)
    ]
    if at_hands is not None:
        windows += [(f"at the hands x{s:g}", square(at_hands, s * side)) for s in looks.hands]
    return windows
