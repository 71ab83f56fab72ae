"""How good the masks are on renders that training never saw, beside GrabCut, from detected boxes.

The main object of every validation picture is segmented from the box that the detector finds for
it (of any class: choosing the class is another part's work). Pictures in which it finds none are
counted, and their masks are made from the true box in rows of their own.

``plain_grabcut`` is OpenCV's, which knows only the box, ``grabcut`` ours, which knows the person.
``segmenter`` is what the detect stage does: the network and GrabCut, again from the mask's own box.
``in_use`` is the network without any box, asked what the person uses.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from hoi.detect.agreement import mask_iou
from hoi.detect.backends import Box, DetectedBox, PersonPose
from hoi.detect.blazepose import BlazePose
from hoi.detect.boxes import mask_box, overlap
from hoi.detect.config import DetectConfig
from hoi.detect.grabcut import GrabCut, plain_grabcut
from hoi.detect.labels import PERSON
from hoi.detect.nanodet import NanoDet
from hoi.detect.resegment import segment_again
from hoi.detect.segmenter import Segmenter, refined
from hoi.segmenter.crops import used_window
from hoi.segmenter.onlookers import boxes_of_things, detected_around
from hoi.segmenter.pictures import Picture, load_picture
from hoi.segmenter.runtime import MaskNetwork

log = logging.getLogger(__name__)
METHODS = ("plain_grabcut", "grabcut", "network", "network_grabcut", "segmenter", "in_use")


class Evaluator:
    """Segments the main object of pictures by every method.

    Args:
        weights: the network's file.
        models_dir: the detectors' files.
        minimum_overlap: IoU from which a detector's box counts as the object's.
        config: of the detect stage.
    """

    def __init__(
        self,
        weights: Path,
        models_dir: Path,
        minimum_overlap: float,
        config: DetectConfig | None = None,
    ):
        self.config = config or DetectConfig()
        self.minimum_overlap = minimum_overlap
        self._boxes = NanoDet(self.config.nanodet, models_dir)
        self._pose = BlazePose(self.config.blazepose, models_dir)
        self._colours = GrabCut(self.config.grabcut, self.config.blazepose.visible)
        self._network = MaskNetwork(weights)
        self._stage = Segmenter(self.config.segmenter, self._network, self._colours)

    def measure(self, image: np.ndarray, truth: np.ndarray, person: np.ndarray) -> dict:
        """IoU of every method in one picture, with the box that they started from.

        Args:
            image: (H, W, 3) uint8 RGB; truth, person: (H, W) bool masks, `person` possibly empty.
        """
        around = mask_box(person) if person.any() else None
        seen = detected_around(self._boxes, image, around)
        pose = self._person(image, person, seen)
        true = mask_box(truth)
        best = max(boxes_of_things(seen), key=lambda box: overlap(box, true), default=None)
        box, row = true, {"box": "true"}
        if best is not None and overlap(best, true) >= self.minimum_overlap:
            box, row = best, {"box": "detected"}
        row |= {name: mask_iou(mask, truth) for name, mask in self._masks(image, box, pose).items()}
        row["in_use"] = np.nan
        if pose.score > 0:
            window = used_window(mask_box(person), image.shape[:2])
            used = self._network.in_use(image, window, pose.probability)
            row["in_use"] = mask_iou(used > self.config.segmenter.threshold, truth)
        return row

    def _masks(self, image: np.ndarray, box: Box, pose: PersonPose) -> dict[str, np.ndarray]:
        settings = self.config.segmenter
        probability = self._stage.probability(image, box, pose)
        return {
            "plain_grabcut": plain_grabcut(image, box, pose, 0)[0],
            "grabcut": self._colours(image, box, pose, 0)[0],
            "network": probability > settings.threshold,
            "network_grabcut": refined(image, box, probability, settings, 0),
            "segmenter": segment_again(self._stage, image, box, pose, 0, self.config.resegment)[0],
        }

    def _person(self, image: np.ndarray, person: np.ndarray, seen: list[DetectedBox]) -> PersonPose:
        shape = image.shape[:2]
        if not person.any():
            return _nobody(shape)
        true = mask_box(person)
        people = [item.box for item in seen if item.label == PERSON]
        best = max(people, key=lambda box: overlap(box, true), default=true)
        box = best if overlap(best, true) >= self.minimum_overlap else true
        side = float(max(shape))
        intrinsics = np.array([[side, 0, shape[1] / 2], [0, side, shape[0] / 2], [0, 0, 1.0]])
        return self._pose(image, box, intrinsics) or _nobody(shape)


def _nobody(shape: tuple[int, int]) -> PersonPose:
    unseen = np.zeros((21, 3), np.float32)
    return PersonPose(unseen, unseen, np.zeros(shape, np.float32), 0.0)


def evaluate(files: Iterable[Path], evaluator: Evaluator) -> pd.DataFrame:
    """One row a picture: its name, the object's title, and :meth:`Evaluator.measure`."""
    rows = []
    for file in files:
        picture = load_picture(file)
        rows.append({"picture": file.stem, "object": picture.instances[0].name})
        rows[-1] |= evaluator.measure(picture.image, *_masks_of(picture))
        log.info("%s", rows[-1])
    return pd.DataFrame(rows)


def _masks_of(picture: Picture) -> tuple[np.ndarray, np.ndarray]:
    return picture.mask_of("main"), picture.mask_of("person")


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean and median IoU, and the share over one half, of every method by kind of box."""
    parts = []
    for box in ("detected", "true", "all"):
        chosen = rows if box == "all" else rows[rows["box"] == box]
        for method in METHODS:
            values = np.asarray(chosen[method], float)
            values = values[np.isfinite(values)]  # nobody to ask about: in_use says nothing
            parts.append(
                {
                    "box": box,
                    "method": method,
                    "n": len(values),
                    "mean_iou": values.mean() if len(values) else np.nan,
                    "median_iou": np.median(values) if len(values) else np.nan,
                    "over_half": (values > 0.5).mean() if len(values) else np.nan,
                }
            )
    return pd.DataFrame(parts)
