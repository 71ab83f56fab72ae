"""2D keypoints of other systems: OpenPose, COCO (also AlphaPose, detectron2), MMPose json."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hoi.body.keypoints import FROM_BODY25, FROM_COCO17, KEYPOINTS, convert_keypoints
from hoi.errors import AssetError
from hoi.readers.coco import entries_of
from hoi.readers.config import KeypointFiles
from hoi.readers.files import entry, listed, numbers, read_json
from hoi.readers.paths import FrameNames, fill, is_per_frame

_OCCLUDED = 0.5  # confidence of a keypoint that an annotator placed without seeing it


def _rows(names: dict[str, int]) -> np.ndarray:
    return np.array([names.get(name, -1) for name in KEYPOINTS], np.int64)


_COCO17 = dict(zip(KEYPOINTS[:17], range(17), strict=True))
#: OpenPose's older COCO model, with a neck as its second keypoint.
FROM_COCO18 = _rows(
    dict(nose=0, right_shoulder=2, right_elbow=3, right_wrist=4, left_shoulder=5, left_elbow=6)
    | dict(left_wrist=7, right_hip=8, right_knee=9, right_ankle=10, left_hip=11, left_knee=12)
    | dict(left_ankle=13, right_eye=14, left_eye=15, right_ear=16, left_ear=17)
)
#: COCO-WholeBody: six foot keypoints after COCO's seventeen, then face and hands.
FROM_WHOLEBODY = _rows(_COCO17 | dict(left_toe=17, left_heel=19, right_toe=20, right_heel=22))
#: Halpe: head, neck, hip and six foot keypoints after COCO's seventeen.
FROM_HALPE = _rows(_COCO17 | dict(left_toe=20, right_toe=21, left_heel=24, right_heel=25))
_OPENPOSE = {25: FROM_BODY25, 18: FROM_COCO18}
_COCO = {17: FROM_COCO17, 23: FROM_WHOLEBODY, 133: FROM_WHOLEBODY, 26: FROM_HALPE, 136: FROM_HALPE}


def read_people(files: KeypointFiles, names: FrameNames, root: Path) -> np.ndarray:
    """(P, 21, 3) keypoints of all people of a frame: x, y in pixels of the stored picture and
    confidence in [0, 1], in the order of :data:`hoi.body.keypoints.KEYPOINTS`.

    Raises AssetError naming file and key; a file that saw nobody gives an empty array.
    """
    path = fill(files.path, names, root)
    readers: dict[str, Callable[[], list[np.ndarray]]] = {
        "openpose": lambda: _openpose(path),
        "mmpose": lambda: _mmpose(path, names),
        "coco_json": lambda: _coco(files, path, names, root),
    }
    people = readers[files.format]()
    return np.stack(people) if people else np.zeros((0, len(KEYPOINTS), 3), np.float32)


def _openpose(path: Path) -> list[np.ndarray]:
    """As OpenPose writes it, or as BEHAVE keeps it (one person, ``body_joints``).

    A person whose keypoints are all zero was not found: OpenPose failed there.
    """
    content = read_json(path)
    if isinstance(content, dict) and "body_joints" in content:
        lists = [("body_joints", content["body_joints"])]
    else:
        people = listed(entry(content, "people", path), "people", path)
        key = "pose_keypoints_2d"
        lists = [(key, entry(person, key, path)) for person in people]
    found = [_converted(_triples(flat, key, path), _OPENPOSE, key, path) for key, flat in lists]
    return [person for person in found if person.any()]


def _coco(files: KeypointFiles, path: Path, names: FrameNames, root: Path) -> list[np.ndarray]:
    annotations = fill(files.annotations, names, root) if files.annotations else None
    found = entries_of(path, annotations, names, is_per_frame(files.path))
    people = []
    for row in found.entries:
        if "keypoints" not in row:
            continue
        table = _triples(row["keypoints"], "keypoints", path)
        if "foot_kpts" in row and len(table) == 17:
            table = np.concatenate([table, _triples(row["foot_kpts"], "foot_kpts", path)])
        if not found.are_results and "score" not in row:  # flags: 0 absent, 1 hidden, 2 seen
            table[:, 2] = np.select([table[:, 2] >= 2, table[:, 2] >= 1], [1.0, _OCCLUDED], 0.0)
        people.append(_converted(table, _COCO, "keypoints", path))
    return people


def _mmpose(path: Path, names: FrameNames) -> list[np.ndarray]:
    """A list of instances of one image, or ``instance_info`` of several frames."""
    content = read_json(path)
    if isinstance(content, dict):
        content = entry(content, "instance_info", path)
    instances = listed(content, "instance_info", path)
    if instances and isinstance(instances[0], dict) and "instances" in instances[0]:
        if len(instances) > 1:
            raise AssetError(
                f"{path}: holds {len(instances)} frames of a video; save one file a photo"
            )
        instances = listed(instances[0]["instances"], "instances", path)
    if len(instances) == 1 and isinstance(instances[0], list):  # one list for each image
        instances = instances[0]
    people = []
    for instance in instances:
        points = numbers(entry(instance, "keypoints", path), "keypoints", path)
        scores = numbers(entry(instance, "keypoint_scores", path), "keypoint_scores", path)
        if points.ndim != 2 or points.shape[1] != 2 or scores.shape != points.shape[:1]:
            raise AssetError(
                f"{path}: keys 'keypoints' {points.shape} and 'keypoint_scores' {scores.shape} "
                "do not fit, expected (K, 2) and (K,)"
            )
        table = np.concatenate([points, scores[:, None]], axis=1)
        people.append(_converted(table, _COCO, "keypoints", path))
    return people


def _triples(flat: Any, key: str, path: Path) -> np.ndarray:
    values = numbers(flat, key, path).ravel()
    if not len(values) or len(values) % 3:
        raise AssetError(f"{path}: key {key!r} holds {len(values)} numbers, expected x, y, score")
    return values.reshape(-1, 3)


def _converted(table: np.ndarray, maps: dict[int, np.ndarray], key: str, path: Path) -> np.ndarray:
    if len(table) not in maps:
        raise AssetError(
            f"{path}: key {key!r} holds {len(table)} keypoints, "
            f"known are {', '.join(map(str, maps))}"
        )
    if np.abs(table).max() > 1e6:
        raise AssetError(f"{path}: key {key!r} holds {np.abs(table).max():.3g}, no pixel")
    found = convert_keypoints(table, maps[len(table)])
    found[:, 2] = np.clip(found[:, 2], 0, 1)
    return found
