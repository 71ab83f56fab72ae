"""Silhouettes and depth maps of meshes on the CPU, fast and differentiable.

Image coordinates: the pixel in column c and row r covers [c, c+1) x [r, r+1). Kernels are
single-threaded; parallelism belongs to whoever runs many frames. The functions that take placements
or camera-frame vertices clip at the near plane exactly. Those that take image coordinates cannot:
:func:`hoi.geometry.project` clamps depths there, which draws wrongly but finitely.
"""

from hoi.rendering.clipping import clip_near
from hoi.rendering.depth import depth_map
from hoi.rendering.off_screen import off_screen
from hoi.rendering.roi import Roi, crop_mask, intrinsics_for
from hoi.rendering.silhouette import (
    pose_silhouette_iou,
    pose_silhouette_loss,
    render_silhouette,
    silhouette_iou,
    silhouette_loss,
)
from hoi.rendering.target import SilhouetteTarget
from hoi.rendering.topology import MeshTopology
from hoi.rendering.warmup import warm_up

__all__ = [
    "MeshTopology",
    "Roi",
    "SilhouetteTarget",
    "clip_near",
    "crop_mask",
    "depth_map",
    "intrinsics_for",
    "off_screen",
    "pose_silhouette_iou",
    "pose_silhouette_loss",
    "render_silhouette",
    "silhouette_iou",
    "silhouette_loss",
    "warm_up",
]
