"""A picture of a body's named regions, to see that they lie where their names say."""

from __future__ import annotations

import colorsys
from pathlib import Path

import cv2
import numpy as np

from hoi.body import BodyModel, part_vertices
from hoi.report.raycast import Surface, orthographic_rays, shoot

#: Drawn in this order, later ones over earlier ones: wholes (arm, leg) lie under their parts.
SHOWN = (
    *("torso", "left_arm", "right_arm", "left_leg", "right_leg", "head", "neck"),
    *("left_forearm", "right_forearm", "left_thigh", "right_thigh", "lap"),
    *("back", "chest", "belly", "butt", "shoulders", "waist", "mouth"),
    *("left_hand", "right_hand", "left_foot", "right_foot"),
)
_HEIGHT, _WIDTH, _SUPERSAMPLING = 900, 760, 2
_MARGIN = 1.06


def parts_picture(model: BodyModel) -> np.ndarray:
    """(H, W, 3) uint8 RGB: the template from the front, from the back, and a legend."""
    parts = part_vertices(model)
    colours = np.full((model.num_vertices, 3), 200.0)
    palette = {name: _colour(number) for number, name in enumerate(SHOWN)}
    for name in SHOWN:
        colours[parts[name]] = palette[name]
    surface = Surface(model.v_template, model.faces, colours, smooth=True)
    low, high = model.v_template.min(0), model.v_template.max(0)
    span = _MARGIN * max(high[1] - low[1], (high[0] - low[0]) * _HEIGHT / _WIDTH)
    views = []
    for right in (1.0, -1.0):  # seen from the front, the person's left is on the right
        rays = orthographic_rays(
            (low + high) / 2,
            np.array([right, 0.0, 0.0]),
            np.array([0.0, 1.0, 0.0]),
            (span * _WIDTH / _HEIGHT, span),
            _WIDTH * _SUPERSAMPLING,
            _HEIGHT * _SUPERSAMPLING,
        )
        shot = shoot([surface], rays, _SUPERSAMPLING)
        cover = shot.coverage[..., None]
        views.append(cover * shot.colour + (1 - cover) * 255.0)
    return np.concatenate([*views, _legend(palette)], axis=1).round().astype(np.uint8)


def write_parts_picture(body_model: Path, path: Path) -> None:
    """Draw the regions of a body model file into a png; raises AssetError."""
    picture = parts_picture(BodyModel.load(body_model))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", picture[..., ::-1])[1].tobytes())


def _colour(number: int) -> tuple[float, float, float]:
    hue, light = (number * 0.381966) % 1.0, (0.45, 0.62, 0.75)[number % 3]
    red, green, blue = colorsys.hls_to_rgb(hue, light, 0.75)
    return 255 * red, 255 * green, 255 * blue


def _legend(palette: dict[str, tuple[float, float, float]]) -> np.ndarray:
    picture = np.full((_HEIGHT, 220, 3), 255, np.uint8)
    for row, (name, colour) in enumerate(palette.items()):
        top = 20 + row * 32
        picture[top : top + 22, 12:42] = np.round(colour)
        cv2.putText(
            picture, name, (52, top + 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA
        )
    return picture
