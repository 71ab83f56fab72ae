"""BlazePose: a person's keypoints, 3D landmarks and mask, by the LiteRT runtime.

Coordinates here are continuous: pixel (column c, row r) covers [c, c+1) x [r, r+1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from hoi.body.keypoints import FROM_BLAZEPOSE33, convert_keypoints
from hoi.detect.backends import Box, PersonPose
from hoi.detect.boxes import area, grown, longer_side, middle, pixel_window, shared_area
from hoi.detect.config import BlazePoseConfig
from hoi.detect.nanodet import letterbox

DETECTOR_SIDE, LANDMARK_SIDE = 224, 256
_ANCHORS = ((8, 2), (16, 2), (32, 6))  # stride, anchors per cell
# Rows 33 and 34 of the landmark output: the centre of the hips, and a point on the circle around
# the whole body; rows 0-32 are the body.
_BODY, _CENTRE, _CIRCLE = 33, 33, 34
_HIPS = [23, 24]
_MINIMUM_RADIUS = 4.0  # pixels; a smaller circle says nothing about size or rotation
_OUTSIDE_LOGIT = -10.0


@dataclass(frozen=True)
class Crop:
    """A square view of the image: its centre and side in pixels, its roll in radians.

    The crop is what a camera turned towards `centre` would see, not a piece cut out: in a wide
    picture a person at the side is stretched and seen at an angle, and a landmark model, which
    takes every crop for a picture of its own, would answer with a body turned by half that angle.
    """

    centre: np.ndarray
    side: float
    roll: float

    def camera_from_crop(self, intrinsics: np.ndarray) -> np.ndarray:
        """(3, 3) rotation to camera axes from those of the turned camera."""
        turn = np.eye(3)
        turn[:2, :2] = _turn(self.roll)
        return camera_from_view(self.centre, intrinsics) @ turn

    def image_from_crop(self, intrinsics: np.ndarray) -> np.ndarray:
        """(3, 3) homography from the 256 x 256 crop, continuous coordinates."""
        rotation = self.camera_from_crop(intrinsics)
        # Off the axis an image is stretched by 1 / cos along the circle around the principal
        # point and by 1 / cos^2 across it; the crop is sized by the mean.
        focal = np.sqrt(intrinsics[0, 0] * intrinsics[1, 1]) / rotation[2, 2] ** 1.5
        zoom, half = focal * LANDMARK_SIDE / self.side, LANDMARK_SIDE / 2
        crop = np.array([[zoom, 0, half], [0, zoom, half], [0, 0, 1.0]])
        return intrinsics @ rotation @ np.linalg.inv(crop)


@dataclass(frozen=True)
class _Reading:
    """The landmark model's answer, in image coordinates."""

    image_from_crop: np.ndarray  # (3, 3)
    points: np.ndarray  # (39, 2) pixels
    confidence: np.ndarray  # (39,)
    world: np.ndarray  # (39, 3) metres, camera axes
    mask_logits: np.ndarray  # (256, 256) on the crop
    score: float


class BlazePose:
    """A :class:`hoi.detect.backends.PoseEstimator`.

    Args:
        config: its settings.
        models_dir: folder with ``pose_detection.tflite`` and ``pose_landmark_*.tflite``.
    """

    def __init__(self, config: BlazePoseConfig, models_dir: Path):
        from ai_edge_litert.interpreter import Interpreter

        self.config = config
        landmark_file = models_dir / f"pose_landmark_{config.complexity}.tflite"
        self._landmarks = _Model(Interpreter, landmark_file, config.threads)
        self._detector = _Model(Interpreter, models_dir / "pose_detection.tflite", config.threads)
        self._anchors = detector_anchors()

    def __call__(self, image: np.ndarray, box: Box, intrinsics: np.ndarray) -> PersonPose | None:
        """The person in `box` (x0, y0, x1, y1), or None when the model sees nobody there."""
        shape = image.shape[:2]
        readings = [self._read(image, crop, intrinsics) for crop in self._first_crops(image, box)]
        unseen = max(reading.score for reading in readings) < self.config.minimum_score
        if unseen or _at_border(box, shape, self.config.cut_margin):
            wide = [self._read(image, crop, intrinsics) for crop in self._wide_crops(box)]
            least = self.config.minimum_inside
            readings += [reading for reading in wide if self._inside(reading, box, shape) >= least]
        best = max(readings, key=lambda reading: self._rank(reading, box, shape))
        for _ in range(self.config.passes - 1):
            crop = self._recentred(best)
            if crop is None:
                break
            again = self._read(image, crop, intrinsics)
            if not self._stays(again, best, box, shape):
                break
            best = again
        if best.score < self.config.minimum_score:
            return None
        return self._pose(best, box, shape)

    def _first_crops(self, image: np.ndarray, box: Box) -> list[Crop]:
        """The box's own square, and the detector's if it sees the same person."""
        own = Crop(middle(box), self.config.crop_scale * longer_side(box), 0.0)
        seen = self._detect(image, own, box)
        return [own] if seen is None else [own, seen]

    def _wide_crops(self, box: Box) -> list[Crop]:
        """Squares with room for the part of a body that the picture does not show."""
        centre, side = middle(box), longer_side(box)
        return [
            Crop(centre + np.array([0.0, shift * side]), self.config.wide_scale * side, 0.0)
            for shift in self.config.wide_shifts
        ]

    def _detect(self, image: np.ndarray, around: Crop, box: Box) -> Crop | None:
        """The crop that the person detector proposes inside `around`."""
        x, y = around.centre
        half = around.side * 0.65
        rows, columns = pixel_window((x - half, y - half, x + half, y + half), *image.shape[:2])
        window = image[rows, columns]
        if min(window.shape[:2]) < 2:
            return None
        pixels, scale, offset = letterbox(window, DETECTOR_SIDE)
        raw, logits = self._detector(pixels.astype(np.float32) / 127.5 - 1, (2254, 12), (2254, 1))
        scores = _sigmoid(logits[:, 0])
        values = raw.reshape(-1, 6, 2) / DETECTOR_SIDE
        values[:, 0] += self._anchors
        values[:, 2:] += self._anchors[:, None]
        origin = np.array([columns.start, rows.start])
        points = (values * DETECTOR_SIDE - offset) / scale + origin
        radius = np.linalg.norm(points[:, 3] - points[:, 2], axis=1)
        best: tuple[float, int] | None = None
        for index in np.flatnonzero((scores >= 0.5) & (radius > _MINIMUM_RADIUS)):
            (x, y), size = points[index, 2], radius[index]
            circle = (x - size, y - size, x + size, y + size)
            same = shared_area(circle, box) >= 0.5 * area(box)
            if same and (best is None or scores[index] > best[0]):
                best = float(scores[index]), int(index)
        return None if best is None else self._crop_of(points[best[1], 2], points[best[1], 3])

    def _crop_of(self, centre: np.ndarray, circle: np.ndarray) -> Crop:
        # The circle's point lies above the upright person's head.
        up = circle - centre
        radius = float(np.hypot(*up))
        return Crop(centre, 2 * radius * self.config.crop_scale, float(np.arctan2(up[0], -up[1])))

    def _recentred(self, reading: _Reading) -> Crop | None:
        centre, circle = reading.points[_CENTRE], reading.points[_CIRCLE]
        if reading.score < self.config.minimum_score:
            return None
        if np.hypot(*(circle - centre)) < _MINIMUM_RADIUS:
            return None
        return self._crop_of(centre, circle)

    def _read(self, image: np.ndarray, crop: Crop, intrinsics: np.ndarray) -> _Reading:
        image_from_crop = crop.image_from_crop(intrinsics)
        pixels = cv2.warpPerspective(
            image,
            _between_centres(image_from_crop),
            (LANDMARK_SIDE, LANDMARK_SIDE),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        )
        landmarks, score, mask, world = self._landmarks(
            pixels.astype(np.float32) / 255, (195,), (1,), (256, 256, 1), (117,)
        )
        landmarks, world = landmarks.reshape(39, 5), world.reshape(39, 3)
        points = np.column_stack([landmarks[:, :2], np.ones(39)]) @ image_from_crop.T
        return _Reading(
            image_from_crop,
            points[:, :2] / points[:, 2:],
            np.minimum(_sigmoid(landmarks[:, 3]), _sigmoid(landmarks[:, 4])),
            world @ crop.camera_from_crop(intrinsics).T,
            mask[..., 0],
            float(score[0]),
        )

    def _inside(self, reading: _Reading, box: Box, shape: tuple[int, ...]) -> float:
        """Share of the visible keypoints in the widened box; 0 when none is visible."""
        seen = (reading.confidence[:_BODY] >= self.config.visible) & _within(
            reading.points[:_BODY], (0, 0, shape[1], shape[0])
        )
        if not seen.any():
            return 0.0
        widened = grown(box, self.config.box_slack * longer_side(box))
        return float(_within(reading.points[:_BODY][seen], widened).mean())

    def _rank(self, reading: _Reading, box: Box, shape: tuple[int, ...]) -> float:
        return reading.score * self._inside(reading, box, shape)

    def _stays(self, again: _Reading, before: _Reading, box: Box, shape: tuple[int, ...]) -> bool:
        inside = self._inside(again, box, shape)
        needed = min(self.config.minimum_inside, self._inside(before, box, shape))
        return again.score >= self.config.minimum_score and inside >= needed and inside > 0

    def _pose(self, reading: _Reading, box: Box, shape: tuple[int, ...]) -> PersonPose:
        height, width = shape
        # What lies outside the picture was guessed, not seen.
        seen = _within(reading.points[:_BODY], (0, 0, width, height))
        confidence = np.where(seen, reading.confidence[:_BODY], 0.0)
        points = np.column_stack([reading.points[:_BODY], confidence])
        world = reading.world[:_BODY]
        hips = world[_HIPS].mean(0)
        probability = np.zeros((height, width), np.float32)
        rows, columns = pixel_window(
            grown(box, self.config.box_slack * longer_side(box)), height, width
        )
        logits = cv2.warpPerspective(
            reading.mask_logits,
            _shift(-columns.start, -rows.start) @ _between_centres(reading.image_from_crop),
            (columns.stop - columns.start, rows.stop - rows.start),
            flags=cv2.INTER_LINEAR,
            borderValue=_OUTSIDE_LOGIT,
        )
        probability[rows, columns] = _sigmoid(logits)
        return PersonPose(
            convert_keypoints(points, FROM_BLAZEPOSE33),
            convert_keypoints(world - hips, FROM_BLAZEPOSE33),
            probability,
            reading.score,
        )


def detector_anchors() -> np.ndarray:
    """(2254, 2) centres of the detector's anchors, in shares of its square input."""
    anchors = []
    for stride, per_cell in _ANCHORS:
        cells = DETECTOR_SIDE // stride
        rows, columns = np.divmod(np.arange(cells * cells), cells)
        centres = (np.stack([columns, rows], 1) + 0.5) / cells
        anchors.append(centres.repeat(per_cell, 0))
    return np.concatenate(anchors)


def camera_from_view(centre: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """(3, 3) rotation to camera axes from the axes of a camera that looks at pixel `centre`."""
    ray = np.linalg.solve(intrinsics, np.array([centre[0], centre[1], 1.0]))
    ray /= np.linalg.norm(ray)
    axis = np.cross([0.0, 0.0, 1.0], ray)
    sine = np.linalg.norm(axis)
    if sine < 1e-12:
        return np.eye(3)
    rotation, _ = cv2.Rodrigues(axis / sine * np.arctan2(sine, ray[2]))
    return rotation


class _Model:
    """One .tflite file: an image in, outputs told apart by their shapes."""

    def __init__(self, interpreter_type, path: Path, threads: int):
        self._interpreter = interpreter_type(model_path=str(path), num_threads=threads)
        self._interpreter.allocate_tensors()
        self._input = self._interpreter.get_input_details()[0]["index"]
        self._outputs = {
            tuple(int(size) for size in detail["shape"][1:]): detail["index"]
            for detail in self._interpreter.get_output_details()
        }

    def __call__(self, image: np.ndarray, *shapes: tuple[int, ...]) -> list[np.ndarray]:
        self._interpreter.set_tensor(self._input, np.ascontiguousarray(image[None], np.float32))
        self._interpreter.invoke()
        return [np.array(self._interpreter.get_tensor(self._outputs[shape])[0]) for shape in shapes]


def _turn(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])


def _shift(x: float, y: float) -> np.ndarray:
    return np.array([[1.0, 0, x], [0, 1, y], [0, 0, 1]])


def _between_centres(homography: np.ndarray) -> np.ndarray:
    """OpenCV counts from pixel centres: the same map between integer pixel indices."""
    return _shift(-0.5, -0.5) @ homography @ _shift(0.5, 0.5)


def _at_border(box: Box, shape: tuple[int, ...], margin: float) -> bool:
    """Whether the box reaches the border of the picture."""
    near = margin * longer_side(box)
    height, width = shape
    return min(box[0], box[1]) <= near or box[2] >= width - near or box[3] >= height - near


def _within(points: np.ndarray, box: Sequence[float]) -> np.ndarray:
    low, high = np.asarray(box[:2]), np.asarray(box[2:])
    inside: np.ndarray = np.logical_and(points >= low, points < high)
    return np.all(inside, axis=-1)


def _sigmoid(values: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip(values.astype(np.float64), -60, 60)))
