"""An object's mask from its box by GrabCut, with the person as probable background.

Colour alone decides, so the mask is a rough one: thin parts and objects coloured like what is
behind them suffer most.
"""

from __future__ import annotations

import cv2
import numpy as np

from hoi.body.keypoints import KEYPOINT
from hoi.detect.backends import Box, PersonPose
from hoi.detect.boxes import clipped, grown, longer_side, pixel_window
from hoi.detect.config import GrabCutConfig

LIMBS: tuple[tuple[str, str], ...] = tuple(
    (f"{side}_{first}", f"{side}_{second}")
    for side in ("left", "right")
    for first, second in (
        ("shoulder", "elbow"),
        ("elbow", "wrist"),
        ("shoulder", "hip"),
        ("hip", "knee"),
        ("knee", "ankle"),
        ("ankle", "heel"),
        ("ankle", "toe"),
        ("ear", "shoulder"),
    )
) + (("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"))
_PLAIN_SIDE = 640  # pixels
_TRUNK = ("left_shoulder", "right_shoulder", "right_hip", "left_hip")


class GrabCut:
    """An :class:`hoi.detect.backends.ObjectSegmenter`.

    Sources it reports: ``grabcut``, with the person as probable background;
    ``grabcut_ignoring_person``, where the person's mask fills the box (pose models swallow worn
    bags) or the first attempt finds next to nothing; and if that does no better,
    ``box_minus_person``, or ``box`` where the mask fills it.
    """

    def __init__(self, config: GrabCutConfig, visible: float):
        self.config = config
        self.visible = visible

    def __call__(
        self, image: np.ndarray, box: Box, pose: PersonPose, seed: int
    ) -> tuple[np.ndarray, str]:
        in_box = np.zeros(image.shape[:2], bool)
        in_box[pixel_window(box, *image.shape[:2])] = True
        person = pose.probability > 0.5
        skeleton = draw_skeleton(
            image.shape[:2], pose.keypoints, self.visible, self.config.limb_width
        )
        nothing = np.zeros_like(person)
        needed = max(self.config.minimum_fill * in_box.sum(), 1.0)
        swallowed = (in_box & person).sum() >= self.config.swallowed * in_box.sum()
        attempts = [("grabcut_ignoring_person", nothing, nothing)]
        if not swallowed:
            attempts.insert(0, ("grabcut", person, skeleton))
        for source, unlikely, excluded in attempts:
            mask = self._segment(image, box, unlikely, excluded, seed) & in_box
            if mask.sum() >= needed:
                return mask, source
        mask = in_box & ~person
        return (in_box, "box") if swallowed or not mask.any() else (mask, "box_minus_person")

    def _segment(
        self, image: np.ndarray, box: Box, person: np.ndarray, skeleton: np.ndarray, seed: int
    ) -> np.ndarray:
        height, width = image.shape[:2]
        window = pixel_window(grown(box, self.config.context * longer_side(box)), height, width)
        crop = image[window]
        result = np.zeros((height, width), bool)
        if min(crop.shape[:2]) < 2:
            return result
        scale = min(1.0, self.config.longest_side / max(crop.shape[:2]))
        size = max(round(crop.shape[1] * scale), 2), max(round(crop.shape[0] * scale), 2)
        small = cv2.resize(crop, size, interpolation=cv2.INTER_AREA)
        origin = np.array([window[1].start, window[0].start] * 2)
        stretch = np.array([size[0] / crop.shape[1], size[1] / crop.shape[0]] * 2)
        inside = pixel_window(((np.asarray(box) - origin) * stretch).tolist(), size[1], size[0])
        labels = np.full(small.shape[:2], cv2.GC_BGD, np.uint8)
        labels[inside] = cv2.GC_PR_FGD
        labels[(labels == cv2.GC_PR_FGD) & _shrunk(person[window], size)] = cv2.GC_PR_BGD
        labels[_shrunk(skeleton[window], size)] = cv2.GC_BGD
        foreground = labels == cv2.GC_PR_FGD
        if not foreground.any() or foreground.all():
            return result
        # GrabCut seeds its colour clusters from OpenCV's own generator.
        cv2.setRNGSeed(seed % (2**31))
        models = np.zeros((1, 65)), np.zeros((1, 65))
        lab = cv2.cvtColor(small, cv2.COLOR_RGB2LAB)
        mode = cv2.GC_INIT_WITH_MASK
        cv2.grabCut(lab, labels, (0, 0, 0, 0), *models, self.config.iterations, mode)
        found = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.float32)
        result[window] = cv2.resize(found, crop.shape[1::-1]) > 0.5
        return result


def plain_grabcut(
    image: np.ndarray, box: Box, pose: PersonPose, seed: int
) -> tuple[np.ndarray, str]:
    """GrabCut as OpenCV documents it: the whole picture, the box, five iterations, no person.

    The baseline that everybody has; pictures are reduced to 640 pixels. Answers with the box where
    that leaves nothing outside or is too thin to have an inside.
    """
    height, width = image.shape[:2]
    whole = np.zeros((height, width), bool)
    whole[pixel_window(box, height, width)] = True
    scale = min(1.0, _PLAIN_SIDE / max(height, width))
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    x0, y0, x1, y1 = (round(edge * scale) for edge in clipped(box, height, width))
    if x1 - x0 < 2 or y1 - y0 < 2 or (x1 - x0, y1 - y0) == size:
        return whole, "box"
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    labels = np.zeros(small.shape[:2], np.uint8)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.setRNGSeed(seed % (2**31))
    cv2.grabCut(small, labels, (x0, y0, x1 - x0, y1 - y0), *models, 5, cv2.GC_INIT_WITH_RECT)
    found = np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.float32)
    return cv2.resize(found, (width, height)) > 0.5, "plain_grabcut"


def _shrunk(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5


def draw_skeleton(
    shape: tuple[int, int], keypoints: np.ndarray, visible: float, limb_width: float
) -> np.ndarray:
    """Pixels that are surely the person: limbs between seen keypoints, and the trunk.

    Args:
        shape: height and width of the mask.
        keypoints: (21, 3) x, y in pixels and confidence.
        visible: confidence from which a keypoint counts as seen.
        limb_width: width of a limb as a share of the longer side of the seen keypoints' box.
    """
    canvas = np.zeros(shape, np.uint8)
    seen = keypoints[:, 2] >= visible
    if seen.sum() < 2:
        return canvas > 0
    spread = np.ptp(keypoints[seen, :2], axis=0).max()
    width = max(round(float(spread) * limb_width), 1)
    points = np.floor(keypoints[:, :2]).astype(np.int32)
    for first, second in LIMBS:
        a, b = KEYPOINT[first], KEYPOINT[second]
        if seen[a] and seen[b]:
            cv2.line(canvas, points[a].tolist(), points[b].tolist(), 1, width)
    trunk = [KEYPOINT[name] for name in _TRUNK]
    if seen[trunk].all():
        cv2.fillConvexPoly(canvas, points[trunk], 1)
    return canvas > 0
