"""The 21 image keypoints every stage uses, where they lie on a body, and maps from detectors."""

from __future__ import annotations

import numpy as np

from hoi.body.skeleton import JOINT

KEYPOINTS: tuple[str, ...] = (
    "nose",
    "left_eye",
    "right_eye",
    "left_ear",
    "right_ear",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
    "left_toe",
    "right_toe",
    "left_heel",
    "right_heel",
)
KEYPOINT: dict[str, int] = {name: index for index, name in enumerate(KEYPOINTS)}

#: Keypoints that are no joint of the skeleton but points of the skin, in file order.
SURFACE_KEYPOINTS: tuple[str, ...] = tuple(name for name in KEYPOINTS if name not in JOINT)


def _source(names: dict[str, int]) -> np.ndarray:
    return np.array([names.get(name, -1) for name in KEYPOINTS], dtype=np.int64)


#: Row of the OpenPose BODY_25 array that holds each keypoint (-1: absent). BEHAVE's
#: ``*.color.json`` files are in this order.
FROM_BODY25 = _source(
    dict(nose=0, right_shoulder=2, right_elbow=3, right_wrist=4, left_shoulder=5, left_elbow=6)
    | dict(left_wrist=7, right_hip=9, right_knee=10, right_ankle=11, left_hip=12, left_knee=13)
    | dict(left_ankle=14, right_eye=15, left_eye=16, right_ear=17, left_ear=18, left_toe=19)
    | dict(left_heel=21, right_toe=22, right_heel=24)
)

#: Row of MediaPipe BlazePose's 33 landmarks (its foot index is the big toe).
FROM_BLAZEPOSE33 = _source(
    dict(nose=0, left_eye=2, right_eye=5, left_ear=7, right_ear=8, left_shoulder=11)
    | dict(right_shoulder=12, left_elbow=13, right_elbow=14, left_wrist=15, right_wrist=16)
    | dict(left_hip=23, right_hip=24, left_knee=25, right_knee=26, left_ankle=27)
    | dict(right_ankle=28, left_heel=29, right_heel=30, left_toe=31, right_toe=32)
)

#: Row of the 17 COCO keypoints.
FROM_COCO17 = _source({name: row for row, name in enumerate(KEYPOINTS[:17])})


def convert_keypoints(source: np.ndarray, index_map: np.ndarray) -> np.ndarray:
    """Reorder detector keypoints to :data:`KEYPOINTS`.

    Args:
        source: (N, 3) x, y in pixels and confidence, in the detector's order.
        index_map: FROM_BODY25, FROM_BLAZEPOSE33 or FROM_COCO17.
    Returns:
        (21, 3) float32; a keypoint the detector does not have is all zero.
    """
    rows = np.asarray(source, dtype=np.float32)[np.maximum(index_map, 0)]
    return np.where((index_map >= 0)[:, None], rows, np.float32(0))


def derive_surface_regressor(
    vertices: np.ndarray, weights: np.ndarray, joints: np.ndarray, neighbours: int = 4
) -> np.ndarray:
    """Where nose, eyes, ears, toes and heels lie on a template that does not say so itself.

    Read from the shape alone, for SMPL files: the nose is the foremost point of the head on the
    sagittal plane, the eyes lie 4.5 cm above and 3 cm beside it on the front of the head, the
    ears are the points of the head that stand out most sideways at that height, the big toe is
    the foremost point on the inner half of the foot and the heel its rearmost point. Lengths
    scale with stature.

    Args:
        vertices: (V, 3) T-pose template, y up, +z front, +x the person's left.
        weights: (V, 24) skinning weights.
        joints: (24, 3) joints of the template.
        neighbours: vertices averaged per keypoint, so that one odd vertex does not decide.
    Returns:
        (9, V) float32 rows that sum to one, in the order of :data:`SURFACE_KEYPOINTS`.
    """
    scale = np.ptp(vertices[:, 1]) / 1.7
    owner = weights.argmax(1)
    head = np.flatnonzero(owner == JOINT["head"])
    x, y, z = vertices.T

    def foremost(candidates: np.ndarray, score: np.ndarray) -> np.ndarray:
        return vertices[candidates[np.argmax(score[candidates])]]

    nose = foremost(head[np.abs(x[head]) < 0.012 * scale], z)
    targets = {"nose": nose}
    level = head[np.abs(y[head] - nose[1] - 0.015 * scale) < 0.035 * scale]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        eye = nose + scale * np.array([sign * 0.03, 0.045, -0.02])
        targets[f"{side}_eye"] = vertices[head[_nearest(vertices[head], eye, 1)[0]]]
        targets[f"{side}_ear"] = foremost(level, sign * x)
        ankle = joints[JOINT[f"{side}_ankle"]]
        foot = np.flatnonzero(
            np.isin(owner, (JOINT[f"{side}_ankle"], JOINT[f"{side}_foot"])) & (y < ankle[1])
        )
        inner = foot[sign * (x[foot] - np.median(x[foot])) < 0.0]
        targets[f"{side}_toe"] = foremost(inner, z)
        targets[f"{side}_heel"] = foremost(foot, -z)

    regressor = np.zeros((len(SURFACE_KEYPOINTS), len(vertices)), np.float32)
    for row, name in enumerate(SURFACE_KEYPOINTS):
        regressor[row, _nearest(vertices, targets[name], neighbours)] = 1.0 / neighbours
    return regressor


def _nearest(points: np.ndarray, target: np.ndarray, count: int) -> np.ndarray:
    return np.argsort(np.linalg.norm(points - target, axis=1), kind="stable")[:count]
