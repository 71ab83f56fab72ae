"""Silhouettes and depth maps of meshes on the CPU, fast and differentiable.

Image coordinates: the pixel in column c and row r covers [c, c+1) x [r, r+1). Kernels are
single-threaded; parallelism belongs to whoever runs many frames. Points behind the camera never
reach this package as NaN: :func:`hoi.geometry.project` clamps their depth, which draws the mesh
wrongly but finitely, while :func:`depth_map` clips at the near plane exactly.
"""

from hoi.rendering.depth import depth_map
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
    "crop_mask",
    "depth_map",
    "intrinsics_for",
    "pose_silhouette_iou",
    "pose_silhouette_loss",
    "render_silhouette",
    "silhouette_iou",
    "silhouette_loss",
    "warm_up",
]
