"""A body pose without a camera, set upright to be looked at. With numpy alone: pictures start
no torch."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from hoi.body.files import BodyFile
from hoi.body.skeleton import PARENTS
from hoi.body.skinning import skinned

_LEVEL = np.array([0.0, 1.0, 0.0])


def stand(body: BodyFile, body_pose: np.ndarray, pelvis_up: np.ndarray | None = None) -> np.ndarray:
    """Vertices (V, 3) in metres of a posed average body, y up, front about +z, floor at y = 0.

    Args:
        body_pose: (69,) axis-angle, radians.
        pelvis_up: (3,) upward direction in the pelvis frame; None for a level pelvis.
    """
    turn = np.zeros(3)
    if pelvis_up is not None:
        up = np.asarray(pelvis_up, np.float64)
        axis, cosine = np.cross(up, _LEVEL), float(np.clip(up @ _LEVEL, -1, 1))
        length = float(np.linalg.norm(axis))
        turn = axis / length * np.arccos(cosine) if length > 1e-9 else turn
    pose = np.concatenate([turn, np.asarray(body_pose, np.float64)]).reshape(-1, 3)
    points, _ = skinned(body, body.v_template, Rotation.from_rotvec(pose).as_matrix(), PARENTS)
    points[:, 1] -= points[:, 1].min()
    return points
