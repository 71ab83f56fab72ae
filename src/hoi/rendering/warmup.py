"""Compile every kernel once, so that no timed or parallel job pays for it."""

from __future__ import annotations

import numpy as np
import torch

from hoi.rendering.depth import depth_map
from hoi.rendering.silhouette import (
    pose_silhouette_iou,
    pose_silhouette_loss,
    render_silhouette,
    silhouette_iou,
    silhouette_loss,
)
from hoi.rendering.target import SilhouetteTarget
from hoi.rendering.topology import MeshTopology


def warm_up() -> None:
    """Run each kernel on one triangle; numba stores the machine code beside the module.

    The first call takes seconds, later ones (in any process) milliseconds. Results do not depend
    on it.
    """
    corners = np.array([[1.0, 1.0, 4.0], [6.0, 1.5, 4.0], [2.0, 6.0, 4.0]])
    faces = np.array([[0, 1, 2]])
    topology = MeshTopology.from_faces(faces, 3)
    target = SilhouetteTarget(np.ones((8, 8)))
    xy = torch.tensor(corners[None, :, :2], dtype=torch.float32, requires_grad=True)
    loss, _ = silhouette_loss(xy, topology, target, 1.0, 1.0)
    (loss.sum() + render_silhouette(xy, topology, 8, 8).sum()).backward()
    silhouette_iou(xy, topology, target)
    pose = (torch.tensor(corners).float(), torch.eye(3)[None], torch.zeros(1, 3), np.eye(3))
    pose_silhouette_loss(*pose, topology, target)
    pose_silhouette_iou(*pose, topology, target)
    depth_map(corners, faces, np.eye(3), 8, 8)
