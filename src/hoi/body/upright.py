"""A body pose without a camera, set upright to be looked at."""

from __future__ import annotations

import numpy as np
import torch

from hoi.body.model import BodyModel

_LEVEL = np.array([0.0, 1.0, 0.0])


def stand(
    model: BodyModel, body_pose: np.ndarray, pelvis_up: np.ndarray | None = None
) -> np.ndarray:
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
    with torch.no_grad():
        vertices, _ = model(
            *(
                torch.as_tensor(np.asarray(part, np.float32)).reshape(1, -1)
                for part in (turn, body_pose,
                             np.zeros(model.num_betas), np.zeros(3))
            )
        )  # fmt: skip
    points = vertices[0].numpy().astype(np.float64)
    points[:, 1] -= points[:, 1].min()
    return points
