"""A picture of exemplars, coloured by part: the quickest check of shapes and labels."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hoi.exemplars.library import Exemplar
from hoi.exemplars.ray_surface import RaySurface

# One colour a part name, the same in every picture; unknown names cycle through the rest.
PART_COLOURS = {
    "chair_seat": (78, 156, 250),
    "chair_back": (250, 140, 62),
    "chair_base": (182, 122, 216),
    "chair_arm": (92, 196, 98),
    "chair_head": (245, 213, 66),
    "tabletop": (240, 150, 66),
    "table_base": (150, 122, 220),
    "bag_body": (92, 170, 230),
    "shoulder_strap": (238, 120, 70),
    "handle": (110, 200, 100),
    "wheel": (160, 110, 200),
    "frame": (140, 150, 170),
    "key": (248, 160, 70),
    "person": (198, 198, 200),  # for scale
}
_CYCLE = ((98, 170, 240), (244, 146, 70), (110, 198, 110), (186, 126, 216), (240, 208, 80),
          (240, 130, 150), (80, 200, 200), (170, 140, 110), (190, 200, 60), (120, 120, 220),
          (220, 90, 90), (90, 160, 130))  # fmt: skip
_LIGHT = np.array([0.35, 0.62, 0.70]) / np.linalg.norm([0.35, 0.62, 0.70])


def part_colours(part_names: Sequence[str]) -> np.ndarray:
    """(P, 3) uint8 colours of parts, well apart from one another."""
    rows = [PART_COLOURS[name] for name in part_names if name in PART_COLOURS]
    free = [c for c in _CYCLE if all(np.abs(np.subtract(c, row)).sum() > 60 for row in rows)]
    others = itertools.cycle(free or _CYCLE)
    chosen = [PART_COLOURS[n] if n in PART_COLOURS else next(others) for n in part_names]
    return np.array(chosen, np.uint8)


def render(
    exemplar: Exemplar,
    size: int = 220,
    yaw_degrees: float = 35.0,
    pitch_degrees: float = 20.0,
    edges: bool = False,
) -> np.ndarray:
    """(size, size, 3) uint8 picture from the front right and above, scaled to fill the square.

    With `edges` the triangles are outlined.
    """
    yaw, pitch = np.radians([yaw_degrees, pitch_degrees])
    about_y = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
    )
    points = exemplar.vertices @ (about_x @ about_y).T
    points -= (points.min(axis=0) + points.max(axis=0)) / 2
    points /= 1.06 * np.ptp(points[:, :2], axis=0).max()
    across = (np.arange(size) + 0.5) / size - 0.5
    x, y = np.meshgrid(across, -across)
    zero = np.zeros_like(x)
    rays = np.stack([x, y, zero + 5, zero, zero, zero - 1], axis=-1).astype(np.float32)
    hits = RaySurface(points, exemplar.faces).cast(rays)
    hit = np.isfinite(hits["t_hit"])
    normals = hits["primitive_normals"][hit]
    face = hits["primitive_ids"][hit]
    shade = 0.45 + 0.55 * np.abs(normals @ _LIGHT)
    colours = part_colours(exemplar.part_names)[exemplar.face_parts[face]] * shade[:, None]
    if edges:
        u, v = hits["primitive_uvs"][hit].T
        colours[np.minimum(np.minimum(u, v), 1 - u - v) < 0.05] *= 0.45
    image = np.full((size, size, 3), 255, np.uint8)
    image[hit] = np.clip(colours, 0, 255).astype(np.uint8)
    return image


def contact_sheet(
    exemplars: Sequence[Exemplar],
    path: Path | str | None = None,
    columns: int = 5,
    size: int = 220,
    edges: bool = False,
    captions: bool = True,
) -> np.ndarray:
    """Render exemplars side by side, name and size below; written to `path` (PNG) when given.

    Returns the (H, W, 3) uint8 sheet.
    """
    from PIL import Image, ImageDraw

    line = 30 if captions else 0
    rows = -(-len(exemplars) // columns)
    sheet = Image.new("RGB", (columns * size, rows * (size + line)), "white")
    draw = ImageDraw.Draw(sheet)
    for index, exemplar in enumerate(exemplars):
        x, y = index % columns * size, index // columns * (size + line)
        sheet.paste(Image.fromarray(render(exemplar, size, edges=edges)), (x, y))
        if captions:
            extent = " x ".join(f"{v:.2f}" for v in exemplar.size)
            draw.text((x + 4, y + size), exemplar.name, fill="black")
            draw.text(
                (x + 4, y + size + 13), f"{extent} m, {len(exemplar.vertices)} v", fill="gray"
            )
    if path is not None:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        sheet.save(path)
    return np.asarray(sheet)
