"""Cut a mesh at the near plane, so that what reaches past the camera projects rightly."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from hoi.geometry.camera import NEAR


def clip_near(points: Tensor, faces: np.ndarray, near: float = NEAR) -> tuple[Tensor, np.ndarray]:
    """The part of one mesh in front of the plane z = near, differentiable in its vertices.

    Args:
        points: (V, 3) metres, camera frame.
        faces: (F, 3) vertex indices.
        near: metres.

    Returns:
        points (V + N, 3), the old ones and one for each edge that crosses the plane, and the faces
        (F', 3) in front. Faces keep their winding; two that shared an edge share what is left of
        it. The cut itself stays open. Vertices behind the plane belong to no face any more.
    """
    faces = np.asarray(faces, np.int64)
    front = points.detach().cpu().numpy()[:, 2] >= near
    count = front[faces].sum(1)
    # turn each cut face so that its odd corner, alone on its side of the plane, comes first
    cut = faces[(count == 1) | (count == 2)]
    odd = np.where(front[cut].sum(1) == 1, front[cut].argmax(1), front[cut].argmin(1))
    cut = np.take_along_axis(cut, (odd[:, None] + np.arange(3)) % 3, axis=1)
    crossing = np.sort(np.concatenate([cut[:, [0, 1]], cut[:, [0, 2]]]), axis=1)
    edges, place = np.unique(crossing, axis=0, return_inverse=True)
    first, second = (place.reshape(2, -1) + len(points)).astype(np.int64)

    a, b = points[torch.from_numpy(edges[:, 0])], points[torch.from_numpy(edges[:, 1])]
    share = (near - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
    added = a + share * (b - a)
    added = torch.cat((added[:, :2], torch.full_like(added[:, 2:], near)), dim=1)

    tip = front[cut[:, 0]]  # the odd corner is in front: a triangle is left, else a quadrangle
    parts = [
        faces[count == 3],
        np.stack([cut[tip, 0], first[tip], second[tip]], axis=1),
        np.stack([first[~tip], cut[~tip, 1], cut[~tip, 2]], axis=1),
        np.stack([first[~tip], cut[~tip, 2], second[~tip]], axis=1),
    ]
    return torch.cat((points, added)), np.concatenate(parts)
