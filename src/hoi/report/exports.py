"""What a reconstruction is worth outside this program: SMPL parameters, object pose, turntable.

Meshes and GLB scenes are in :mod:`hoi.report.scene`. Everything else here is in the camera's
frame (OpenCV axes: x right, y down, z forward; metres), in which the stages work.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from hoi.artifacts import BodyFit, Frame, Joint, Prior
from hoi.report.colours import rgb
from hoi.report.config import ReportConfig
from hoi.report.doubts import object_sides
from hoi.report.raycast import Surface, orthographic_rays, shoot
from hoi.report.scene import CAMERA_UP, body_colours, followed, of_joint

_TIMESTAMP = (1980, 1, 1, 0, 0, 0)
_TURNTABLE_VIEWS = (4, 2)  # columns, rows: one turn in steps of 45 degrees
_ELEVATION = np.radians(14.0)
_PAPER = 251


def smpl_parameters(body: BodyFit, joint: Joint) -> dict[str, np.ndarray]:
    """SMPL's own parameters by name: ``vertices = scale * model(global_orient, ..., transl)``.

    global_orient (3,), body_pose (69,), betas (B,), transl (3,) metres, scale (), and the fitted
    vertices (V, 3) and joints (24, 3) in the camera's frame, as the scene shows them.
    """
    if not joint.ok or not body.ok or body.global_orient is None:
        raise ValueError(f"frame {joint.frame_id} has no body: {joint.status}")
    found: dict[str, Any] = {
        "global_orient": body.global_orient,
        "body_pose": body.body_pose,
        "betas": body.betas,
        "transl": body.transl,
        "scale": np.array(1.0 if joint.human_scale is None else joint.human_scale),
        "vertices": joint.body_vertices,
        "joints": body.joints if joint.body_joints is None else joint.body_joints,
    }
    return {name: np.asarray(value) for name, value in found.items() if value is not None}


def write_smpl_npz(path: Path | str, body: BodyFit, joint: Joint) -> None:
    """Write :func:`smpl_parameters` as an npz; equal inputs give equal bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in sorted(smpl_parameters(body, joint).items()):
            entry = io.BytesIO()
            np.lib.format.write_array(entry, array, allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", _TIMESTAMP)
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, entry.getvalue())


def object_pose(frame: Frame, prior: Prior | None, joint: Joint) -> dict[str, Any]:
    """The object's pose, size, camera and contacts as plain data for JSON.

    ``vertices_camera = scale * vertices_exemplar @ rotation.T + translation``.
    """
    if not joint.ok or joint.object_rotation is None or joint.object_translation is None:
        raise ValueError(f"frame {joint.frame_id} has no object pose: {joint.status}")
    size = object_sides(joint)
    assert size is not None and frame.intrinsics is not None
    said = followed(joint, prior)
    height, width = (0, 0) if frame.image is None else frame.image.shape[:2]
    return {
        "photo": frame.source or frame.frame_id,
        "object": frame.category,
        "exemplar": joint.exemplar,
        "action": joint.action,
        "rotation": np.round(joint.object_rotation, 6).tolist(),
        "translation_m": np.round(joint.object_translation, 5).tolist(),
        "scale": round(float(joint.object_scale or 1.0), 6),
        "size_m": dict(zip(("width", "height", "depth"), np.round(size, 4).tolist(), strict=True)),
        "camera": {
            "axes": "x right, y down, z forward",
            "intrinsics": np.round(frame.intrinsics, 4).tolist(),
            "image_size": [width, height],
            "focal_length_from": frame.intrinsics_source,
        },
        "contacts": [
            {"object_part": contact.object_part, "body_part": contact.body_part}
            for contact in (said.contacts if said is not None else ())
        ],
    }


def write_object_json(path: Path | str, frame: Frame, prior: Prior | None, joint: Joint) -> None:
    """Write :func:`object_pose`."""
    Path(path).write_text(json.dumps(object_pose(frame, prior, joint), indent=1) + "\n")


def turntable(
    joint: Joint,
    body_faces: np.ndarray,
    config: ReportConfig | None = None,
    up: np.ndarray = CAMERA_UP,
    tile: int = 320,
) -> np.ndarray:
    """Eight views around the scene on one sheet (2 tile, 4 tile, 3) uint8 RGB, 45 degrees apart.

    The first looks as the photo does. `tile` is the width of one view in pixels.
    """
    config = config or ReportConfig()
    scene = of_joint(joint, body_faces, up)
    surfaces = [
        Surface(scene.body_vertices, body_faces, body_colours(scene, config), smooth=True),
        Surface(scene.object_vertices, scene.object_faces, np.array(rgb(config.object_colour))),
    ]
    up = np.asarray(up, float) / np.linalg.norm(up)
    forward = np.array([0.0, 0.0, 1.0]) - up[2] * up
    forward /= np.linalg.norm(forward)
    points = np.concatenate([surface.vertices for surface in surfaces])
    if np.ptp(points, axis=0).max() > config.max_view_span_m:
        points = surfaces[0].vertices  # keep to the person when the object is far away
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = float(np.linalg.norm(points - centre, axis=1).max())
    columns, rows = _TURNTABLE_VIEWS
    sheet = np.full((rows * tile, columns * tile, 3), _PAPER, np.uint8)
    for view in range(columns * rows):
        angle = 2 * np.pi * view / (columns * rows)
        level = np.cos(angle) * forward + np.sin(angle) * np.cross(up, forward)
        right = np.cross(level, up)
        tilted = np.cos(_ELEVATION) * up + np.sin(_ELEVATION) * level
        side = 2.06 * radius
        rays = orthographic_rays(centre, right, tilted, (side, side), 2 * tile, 2 * tile)
        shot = shoot(surfaces, rays, 2)
        alpha = shot.coverage[..., None]
        row, column = divmod(view, columns)
        sheet[row * tile : (row + 1) * tile, column * tile : (column + 1) * tile] = np.round(
            alpha * shot.colour + (1 - alpha) * _PAPER
        ).astype(np.uint8)
    return sheet
