"""One instance-segmentation model in three roles: boxes, the person's mask, the object's mask."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hoi.detect.backends import Box, DetectedBox, ObjectSegmenter, PersonPose
from hoi.detect.boxes import overlap
from hoi.detect.config import DetectConfig, StrongConfig
from hoi.detect.labels import PERSON

_SAME_BOX = 0.5  # IoU from which an instance is what a box was chosen for


@dataclass(frozen=True)
class Instance:
    """One thing: its COCO class, score, box in pixels and mask (H, W) bool."""

    label: str
    score: float
    box: Box
    mask: np.ndarray


#: A model: RGB image (H, W, 3) uint8 -> its instances.
InstanceModel = Callable[[np.ndarray], list[Instance]]


def load_instances(strong: StrongConfig) -> InstanceSegmentation | None:
    """The model that a resolved configuration names; None for ``none``."""
    if strong.instances == "none":
        return None
    if strong.instances == "torchvision":
        from hoi.detect.strong.torchvision_maskrcnn import TorchvisionMaskRcnn as Model
    elif strong.instances == "pointrend":
        from hoi.detect.strong.detectron2_pointrend import Detectron2PointRend as Model
    elif strong.instances == "dfine_seg":
        from hoi.detect.strong.dfine_seg import DFineSeg as Model
    else:
        from hoi.detect.strong.mmdet_rtmdet import RtmDetIns as Model
    files = getattr(strong, strong.instances)
    return InstanceSegmentation(strong.instances, Model(files, strong.device), strong.floor)


class InstanceSegmentation:
    """Runs the model once an image, whatever is asked about it.

    Args:
        name: what the artifacts call it.
        model: the model.
        floor: instances scoring less are dropped.
    """

    def __init__(self, name: str, model: InstanceModel, floor: float):
        self.name, self._model, self._floor = name, model, floor
        self._last: tuple[np.ndarray, list[Instance]] | None = None

    def instances(self, image: np.ndarray) -> list[Instance]:
        """Everything over the floor, best first."""
        if self._last is None or self._last[0] is not image:
            found = [item for item in self._model(image) if item.score >= self._floor]
            found.sort(key=lambda item: (-item.score, item.label, item.box))
            self._last = image, found
        return self._last[1]

    def boxes(self, image: np.ndarray) -> list[DetectedBox]:
        """The role of a :class:`hoi.detect.backends.BoxDetector`."""
        return [DetectedBox(item.label, item.score, item.box) for item in self.instances(image)]

    def person_mask(self, image: np.ndarray, box: Box) -> np.ndarray | None:
        """The mask of the person in `box`, None where there is none."""
        return self._mask(image, box, person=True)

    def object_mask(self, image: np.ndarray, box: Box) -> np.ndarray | None:
        """The mask of the thing in `box`, None where there is none."""
        return self._mask(image, box, person=False)

    def object_masks(self, otherwise: ObjectSegmenter) -> ObjectSegmenter:
        """Masks of objects; boxes that no instance has go to `otherwise`."""

        def segment(
            image: np.ndarray, box: Box, pose: PersonPose, seed: int
        ) -> tuple[np.ndarray, str]:
            mask = self._mask(image, box, person=False)
            if mask is None or not mask.any():
                return otherwise(image, box, pose, seed)
            return mask, self.name

        return segment

    def _mask(self, image: np.ndarray, box: Box, person: bool) -> np.ndarray | None:
        near = [
            (overlap(item.box, box), item.score, item.mask)
            for item in self.instances(image)
            if (item.label == PERSON) == person
        ]
        near = [entry for entry in near if entry[0] >= _SAME_BOX]
        return max(near, key=lambda entry: entry[:2])[2] if near else None


def as_instances(
    labels: list[str | None], scores: np.ndarray, boxes: np.ndarray, masks: np.ndarray
) -> list[Instance]:
    """Instances from parallel arrays; entries without a label are dropped.

    Args:
        labels: COCO names.
        scores: (N,); boxes: (N, 4) x0, y0, x1, y1 in pixels; masks: (N, H, W), true where > 0.5.
    """
    found = []
    for label, score, box, mask in zip(labels, scores, boxes, masks, strict=True):
        if label is not None:
            x0, y0, x1, y1 = (round(float(value), 3) for value in box)
            found.append(Instance(label, float(score), (x0, y0, x1, y1), np.asarray(mask) > 0.5))
    return found


def whole_picture_only(config: DetectConfig) -> DetectConfig:
    """Settings for a model that sees pictures at full size: one look will do, and no advice."""
    looks = config.looks.model_copy(update={"around": (), "around_small": (), "hands": ()})
    return config.model_copy(update={"looks": looks, "unused_weight": 1.0})
