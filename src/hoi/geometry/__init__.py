"""Rotations, cameras, alignment and distances: the geometry every stage shares."""

from hoi.geometry.alignment import chamfer_distance, sample_surface, similarity_procrustes
from hoi.geometry.camera import (
    model_intrinsics,
    project,
    scale_about_camera,
    shift_between_cameras,
)
from hoi.geometry.rotations import (
    axis_angle_to_matrix,
    matrix_to_axis_angle,
    matrix_to_rotation_6d,
    rotation_6d_to_matrix,
    rotation_angle,
    uniform_rotations,
    upright_rotations,
)

__all__ = [
    "axis_angle_to_matrix",
    "chamfer_distance",
    "matrix_to_axis_angle",
    "matrix_to_rotation_6d",
    "model_intrinsics",
    "project",
    "rotation_6d_to_matrix",
    "rotation_angle",
    "sample_surface",
    "scale_about_camera",
    "shift_between_cameras",
    "similarity_procrustes",
    "uniform_rotations",
    "upright_rotations",
]
