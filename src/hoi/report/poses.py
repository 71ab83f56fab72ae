"""Pictures of body poses: the person's, the nearest of the database, and what came next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoi.actions.database import PoseDatabase
from hoi.artifacts import Action, BodyFit
from hoi.body.files import BodyFile
from hoi.report.overlay import Panel
from hoi.report.raycast import Surface, orthographic_rays, shoot

TILE = (104, 150)  # pixels, width and height
SKIN, OTHER = np.array([120, 165, 214.0]), np.array([190, 190, 196.0])
_SPAN_METRES = 1.95  # that a tile is high
_YAW_DEGREES = 35.0
_RUNNERS_UP = 5


@dataclass(frozen=True)
class PoseShelf:
    """What retrieved poses are drawn from: the database that was searched, and a body to pose."""

    database: PoseDatabase
    body: BodyFile


def pose_panels(body: BodyFit | None, action: Action | None, shelf: PoseShelf) -> tuple[Panel, ...]:
    """The person as fitted, the nearest pose, then the nearest of other actions; none without.

    All stand upright and are seen from their front left, at one scale.
    """
    from hoi.actions.retrieval import pelvis_up_in_camera
    from hoi.body.upright import stand

    if action is None or not action.ok or not action.pose_id:
        return ()
    if body is None or not body.ok or body.body_pose is None or body.global_orient is None:
        return ()
    database = shelf.database
    rows = {str(name): row for row, name in enumerate(database.pose_ids.tolist())}
    nearest = str(database.actions[rows[action.pose_id]]) if action.pose_id in rows else ""

    def panel(name: str, title: str, caption: str, pose: np.ndarray, up, colour) -> Panel:
        picture = draw_body(stand(shelf.body, pose, up), shelf.body.faces, colour)
        return Panel(name, title, picture, f"Body pose: {title}, {caption}", caption)

    up = pelvis_up_in_camera(body.global_orient)
    found = [panel("person", "This person", "as fitted", body.body_pose, up, SKIN)]
    answers = [("nearest", nearest, action.pose_id, action.pose_distance, SKIN)]
    for neighbour in action.runners_up:
        if neighbour.pose_id != action.pose_id:
            answers.append(
                ("runner_up", neighbour.action, neighbour.pose_id, neighbour.distance, OTHER)
            )
    for name, said, pose_id, distance, colour in answers[: 1 + _RUNNERS_UP]:
        if pose_id in rows:
            row = rows[pose_id]
            tilt = None if database.pelvis_up is None else database.pelvis_up[row]
            caption = f"{distance:.2f}, {pose_id.replace('_', ' ')}"
            found.append(panel(name, said, caption, database.body_pose[row], tilt, colour))
    return tuple(found)


def draw_body(vertices: np.ndarray, faces: np.ndarray, colour: np.ndarray = SKIN) -> np.ndarray:
    """(H, W, 3) uint8 picture of a body from its front left, at the same scale for all."""
    yaw = np.radians(_YAW_DEGREES)
    right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
    up = np.array([0.0, 1.0, 0.0])
    width, height = TILE
    span = (_SPAN_METRES * width / height, _SPAN_METRES)
    middle = (vertices.min(0) + vertices.max(0)) / 2
    rays = orthographic_rays(middle, right, up, span, 2 * width, 2 * height)
    shot = shoot([Surface(vertices, faces, colour, smooth=True)], rays, supersampling=2)
    cover = shot.coverage[..., None]
    return np.clip(shot.colour * cover + 255 * (1 - cover), 0, 255).astype(np.uint8)
