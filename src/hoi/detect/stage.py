"""The detect stage: from a photo to the person, the object, their masks and keypoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from hoi.artifacts import Candidate, Detection, Frame
from hoi.detect.backends import (
    Box,
    BoxDetector,
    DetectedBox,
    ObjectSegmenter,
    PersonPose,
    PoseEstimator,
    ThingInUse,
)
from hoi.detect.boxes import mask_box
from hoi.detect.choice import Choice, object_failure, person_failure
from hoi.detect.config import DetectConfig
from hoi.detect.finding import PairFinder
from hoi.detect.given import given_instances, given_keypoints, given_mask
from hoi.detect.labels import USER, label_weights
from hoi.detect.models import require_models
from hoi.detect.resegment import segment_again
from hoi.detect.strong.from_box import load_from_box
from hoi.detect.strong.instances import (
    InstanceSegmentation,
    load_instances,
    whole_picture_only,
)
from hoi.detect.strong.selection import resolved
from hoi.errors import FrameFailure

STAGE = "detect"


class DetectionFailure(FrameFailure):
    """A failure that still knows which boxes the detector saw.

    Attributes:
        artifact: the failed Detection, candidates included.
    """

    def __init__(self, frame_id: str, cause: FrameFailure, candidates: list[Candidate]):
        super().__init__(cause.status, cause.detail)
        self.artifact = Detection(
            frame_id=frame_id,
            status=cause.status,
            detail=cause.detail,
            failed_stage=STAGE,
            candidates=candidates,
        )


@dataclass
class _Subjects:
    """The pair that a frame is about, before segmentation."""

    person_box: Box
    object_box: Box
    person: DetectedBox | None = None
    object: DetectedBox | None = None
    pose: PersonPose | None = None
    person_mask: np.ndarray | None = None
    object_mask: np.ndarray | None = None
    candidates: list[Candidate] = field(default_factory=list)


class DetectStage:
    """Section 3.1: boxes, masks and keypoints of one person and one object.

    Args:
        config: what is given, what is detected, and every threshold.
        models_dir: folder of the model files, see :mod:`hoi.detect.models`; may be None when the
            configuration needs none.
        box_detectors, pose_estimator, object_segmenter: other implementations of the roles in
            :mod:`hoi.detect.backends`; by default NanoDet and SSD, BlazePose and the segmenter that
            the configuration names.

    Raises AssetError when a model file that the configuration needs is missing or damaged.
    """

    def __init__(
        self,
        config: DetectConfig,
        models_dir: Path | str | None = None,
        *,
        box_detectors: Mapping[str, BoxDetector] | None = None,
        pose_estimator: PoseEstimator | None = None,
        object_segmenter: ObjectSegmenter | None = None,
    ):
        detects = config.masks != "given"
        strong = None
        if detects:
            config = resolved(config)
            strong = load_instances(config.strong)
        if strong is not None:
            config = whole_picture_only(config)
            box_detectors = {strong.name: strong.boxes}
        self._strong = strong
        self.config = config
        self._pose, self._segment = pose_estimator, object_segmenter
        needs_boxes = detects and box_detectors is None
        needs_pose = config.needed_models != "none" and pose_estimator is None
        if needs_boxes or needs_pose:
            folder = require_models(models_dir, "all" if needs_boxes else "pose")
            if needs_boxes:
                box_detectors = registry_detectors(config, folder)
            if needs_pose:
                from hoi.detect.blazepose import BlazePose

                self._pose = BlazePose(config.blazepose, folder)
        in_use: ThingInUse | None = None
        if detects and object_segmenter is None:
            from hoi.detect.segmenter import Segmenter, object_segmenter_of

            own = object_segmenter_of(config)
            if isinstance(own, Segmenter) and config.unused_weight < 1:
                in_use = own.in_use
            self._segment = load_from_box(config.strong, own)
            if strong is not None and config.strong.from_box == "none":
                self._segment = strong.object_masks(self._segment)
        self._find = None
        if detects and box_detectors:
            self._find = PairFinder(config, box_detectors, self._pose, in_use)

    def __call__(self, frame: Frame, seed: int) -> Detection:
        """Detect in one frame.

        Raises FrameFailure with status ``no_person_detected``, ``several_people``,
        ``no_object_detected``, ``person_mask_empty``, ``object_mask_empty``,
        ``mask_size_mismatch`` or ``no_keypoints``.
        """
        image = frame.image
        assert image is not None  # a frame that is ok has one
        if self._find is None and frame.given_instances:
            return self._from_instances(frame, image, seed)
        if self._find is None:
            return self._describe(frame, image, self._given_subjects(frame), seed)
        person, thing = self._own_mask(frame, "person"), self._own_mask(frame, "object")
        people, choice = self._find(
            image,
            frame.intrinsics,
            frame.category,
            self._weights(frame),
            None if person is None else mask_box(person),
            None if thing is None else mask_box(thing),
            self.config.for_category(frame.category),
            frame.hints,
        )
        candidates = list(choice.candidates)
        try:
            subjects = self._detected_subjects(frame, people, choice, candidates)
            subjects = replace(subjects, person_mask=person, object_mask=thing)
            return self._describe(frame, image, subjects, seed)
        except FrameFailure as failure:
            raise DetectionFailure(frame.frame_id, failure, candidates) from failure

    def pose_of(self, frame: Frame, found: Detection) -> PersonPose | None:
        """The pose read in the person's box that was found, else in the labelled person's."""
        box = None if found.person_box is None else tuple(float(v) for v in found.person_box)
        if box is None and frame.given_person_mask is not None:
            box = mask_box(frame.given_person_mask)
        if self._pose is None or box is None or frame.image is None or frame.intrinsics is None:
            return None
        x0, y0, x1, y1 = box
        return self._pose(frame.image, (x0, y0, x1, y1), frame.intrinsics)

    def _own_mask(self, frame: Frame, which: Literal["person", "object"]) -> np.ndarray | None:
        """The mask that the frame brings, where it is preferred to a detected one."""
        mask = frame.given_person_mask if which == "person" else frame.given_object_mask
        if mask is None or self.config.masks != "prefer_given":
            return None
        return given_mask(frame, which, mask, self.config.minimum_mask_pixels)

    def _given_subjects(self, frame: Frame) -> _Subjects:
        pixels = self.config.minimum_mask_pixels
        person = given_mask(frame, "person", frame.given_person_mask, pixels)
        thing = given_mask(frame, "object", frame.given_object_mask, pixels)
        return _Subjects(mask_box(person), mask_box(thing), person_mask=person, object_mask=thing)

    def _from_instances(self, frame: Frame, image: np.ndarray, seed: int) -> Detection:
        """The pair among what another system segmented, by the rule for detected boxes."""
        segmented = InstanceSegmentation("given", lambda _: given_instances(frame), floor=0.0)
        config = whole_picture_only(self.config)
        people, choice = PairFinder(config, {segmented.name: segmented.boxes}, self._pose)(
            image,
            frame.intrinsics,
            frame.category,
            self._weights(frame),
            config=config.for_category(frame.category),
            hints=frame.hints,
        )
        candidates = list(choice.candidates)
        pixels = config.minimum_mask_pixels
        try:
            subjects = self._detected_subjects(frame, people, choice, candidates)
            person = segmented.person_mask(image, subjects.person_box)
            thing = segmented.object_mask(image, subjects.object_box)
            subjects = replace(
                subjects,
                person_mask=given_mask(frame, "person", person, pixels),
                object_mask=given_mask(frame, "object", thing, pixels),
            )
            return self._describe(frame, image, subjects, seed)
        except FrameFailure as failure:
            raise DetectionFailure(frame.frame_id, failure, candidates) from failure

    def _detected_subjects(
        self, frame: Frame, people: list[DetectedBox], choice: Choice, candidates: list[Candidate]
    ) -> _Subjects:
        config = self.config.for_category(frame.category)
        if choice.person is None:
            raise person_failure(people, config, frame.hints)
        if choice.rivals and config.require_single_person:
            raise FrameFailure(
                "several_people", f"{choice.rivals + 1} people are equally plausible"
            )
        if choice.object is None:
            weights = self._weights(frame)
            raise object_failure(choice, frame.category, weights, config, frame.hints)
        return _Subjects(
            choice.person.box,
            choice.object.box,
            person=choice.person,
            object=choice.object,
            pose=choice.pose,
            candidates=candidates,
        )

    def _weights(self, frame: Frame) -> dict[str, float]:
        return label_weights(frame.category, self.config.labels, self.config.secondary_weight)

    def _describe(
        self, frame: Frame, image: np.ndarray, subjects: _Subjects, seed: int
    ) -> Detection:
        """Masks, keypoints and landmarks of the pair."""
        config = self.config
        pose = subjects.pose
        if self._find is None and self._pose is not None:
            assert frame.intrinsics is not None  # a frame that is ok has them
            pose = self._pose(image, subjects.person_box, frame.intrinsics)
        person_mask, person_source = self._person_mask(image, subjects, pose)
        object_mask, object_source, object_box = self._object_mask(image, subjects, pose, seed)
        if person_source != "given":
            # A pixel shows one thing. The segmenter saw the person mask as a hint and overruled it
            # where the colours say object.
            person_mask = person_mask & ~object_mask
            self._require(person_mask, "person")
        elif object_source != "given":
            object_mask = object_mask & ~person_mask
            self._require(object_mask, "object")
        keypoints, keypoints_source = self._keypoints(frame, pose, person_mask)
        seen = subjects.object if subjects.object_mask is None else None
        if seen is not None and seen.source == USER:
            seen = None
        use_landmarks = config.landmarks == "registry" and pose is not None
        return Detection(
            frame_id=frame.frame_id,
            person_box=np.asarray(subjects.person_box),
            object_box=np.asarray(object_box),
            person_score=_score(subjects.person, subjects.person_mask),
            object_score=_score(subjects.object, subjects.object_mask),
            object_label=frame.category if seen is None else seen.label,
            person_mask=person_mask,
            object_mask=object_mask,
            person_mask_source=person_source,
            object_mask_source=object_source,
            keypoints=keypoints,
            keypoints_source=keypoints_source,
            landmarks=pose.landmarks if use_landmarks and pose else None,
            landmarks_source=self._landmarks_source(pose),
            candidates=subjects.candidates,
        )

    def _person_mask(
        self, image: np.ndarray, subjects: _Subjects, pose: PersonPose | None
    ) -> tuple[np.ndarray, str]:
        if subjects.person_mask is not None:
            return subjects.person_mask, "given"
        if self._strong is not None:
            mask = self._strong.person_mask(image, subjects.person_box)
            if mask is not None and mask.any():
                return mask, self._strong.name
        if pose is None:
            raise FrameFailure(
                "person_mask_empty", "the pose model sees nobody in the person's box"
            )
        mask = pose.probability > self.config.blazepose.mask_threshold
        self._require(mask, "person")
        return mask, "blazepose"

    def _object_mask(
        self, image: np.ndarray, subjects: _Subjects, pose: PersonPose | None, seed: int
    ) -> tuple[np.ndarray, str, Box]:
        """The mask, where it comes from, and the object's box."""
        box = subjects.object_box
        if subjects.object_mask is not None:
            return subjects.object_mask, "given", box
        assert self._segment is not None
        if pose is None:
            raise FrameFailure("no_keypoints", "the pose model sees nobody in the person's box")
        if subjects.object is not None and subjects.object.source == USER:
            mask, source = self._segment(image, box, pose, seed)  # the user's box is final
        else:
            mask, source, box = segment_again(
                self._segment, image, box, pose, seed, self.config.resegment
            )
        self._require(mask, "object")
        return mask, source, box

    def _keypoints(
        self, frame: Frame, pose: PersonPose | None, person_mask: np.ndarray
    ) -> tuple[np.ndarray, str]:
        if self.config.keypoints == "given":
            keypoints, source = given_keypoints(frame, person_mask), "given"
        elif pose is None:
            raise FrameFailure("no_keypoints", "the pose model sees nobody in the person's box")
        else:
            keypoints, source = pose.keypoints, "blazepose"
        found = int((keypoints[:, 2] >= self.config.keypoint_threshold).sum())
        if found < self.config.minimum_keypoints:
            raise FrameFailure(
                "no_keypoints",
                f"{found} keypoints reach confidence {self.config.keypoint_threshold}, "
                f"{self.config.minimum_keypoints} are needed",
            )
        return keypoints, source

    def _landmarks_source(self, pose: PersonPose | None) -> str:
        if self.config.landmarks == "none":
            return "none"
        return "blazepose" if pose is not None else "none: the pose model sees nobody"

    def _require(self, mask: np.ndarray, which: str) -> None:
        pixels = int(mask.sum())
        if pixels < self.config.minimum_mask_pixels:
            raise FrameFailure(f"{which}_mask_empty", f"the {which} mask has {pixels} pixels")


def registry_detectors(config: DetectConfig, models_dir: Path) -> dict[str, BoxDetector]:
    """The box detectors of the registry back end, the one whose people count first."""
    from hoi.detect.nanodet import NanoDet
    from hoi.detect.ssd_oidv4 import SsdOidV4

    return {
        "nanodet": NanoDet(config.nanodet, models_dir),
        "ssd": SsdOidV4(config.ssd, models_dir),
    }


def _score(found: DetectedBox | None, mask: np.ndarray | None) -> float | None:
    """The detector's score; none for what it did not find."""
    if found is None or mask is not None or found.source == USER:
        return None
    return found.score
