"""The picture by which a user accepts an object: its sides, its parts, and a person for scale."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hoi.exemplars.contact_sheet import part_colours, render
from hoi.exemplars.library import Exemplar

PERSON = "person"
# caption, yaw and pitch in degrees of the viewer
_VIEWS = (("front", 0.0, 0.0), ("its left side", 90.0, 0.0), ("from above", 0.0, 90.0),
          ("from the front and above", 35.0, 20.0))  # fmt: skip
_MARGIN, _LINE = 10, 16


def draw_picture(
    exemplar: Exemplar, path: Path | str, title: str, notes: Sequence[str], size: int = 300
) -> np.ndarray:
    """Write a PNG with coloured parts from all sides; returns the (H, W, 3) uint8 picture."""
    from PIL import Image, ImageDraw

    scaled = beside_a_person(exemplar)
    pictures = [render(exemplar, size, yaw, pitch) for _, yaw, pitch in _VIEWS]
    pictures.append(render(scaled, size, 25.0, 8.0))
    captions = [caption for caption, _, _ in _VIEWS] + ["beside a person of 1.7 m"]
    legend = -(-len(exemplar.part_names) // 4)
    top = _MARGIN + 2 * _LINE
    height = top + size + _LINE + (legend + len(notes) + 1) * _LINE + 2 * _MARGIN
    width = len(pictures) * size + 2 * _MARGIN
    sheet = Image.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(sheet)
    extent = " x ".join(f"{side:.2f}" for side in exemplar.size)
    draw.text((_MARGIN, _MARGIN), f"{title}: {exemplar.name}", fill="black")
    told = f"width x height x depth {extent} m, {len(exemplar.vertices)} vertices"
    draw.text((_MARGIN, _MARGIN + _LINE), told, fill=(90, 90, 90))
    for index, (picture, caption) in enumerate(zip(pictures, captions, strict=True)):
        left = _MARGIN + index * size
        sheet.paste(Image.fromarray(picture), (left, top))
        draw.text((left + 6, top + size), caption, fill=(90, 90, 90))
    row = top + size + _LINE + _MARGIN
    colours = part_colours(exemplar.part_names)
    for index, (name, colour) in enumerate(zip(exemplar.part_names, colours, strict=True)):
        left, line = _MARGIN + index % 4 * (width // 4), row + index // 4 * _LINE
        draw.rectangle((left, line + 2, left + 10, line + 12), fill=tuple(colour.tolist()))
        share = float((exemplar.face_parts == index).mean())
        draw.text((left + 16, line), f"{name} ({share:.0%} of the faces)", fill="black")
    for number, note in enumerate(notes):
        draw.text((_MARGIN, row + (legend + number) * _LINE + 4), note, fill=(90, 90, 90))
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)
    return np.asarray(sheet)


def beside_a_person(exemplar: Exemplar) -> Exemplar:
    """One mesh of the object and a standing person to its right, both on the floor."""
    vertices, faces = standing_person()
    gap = 0.15
    low, high = exemplar.vertices.min(axis=0), exemplar.vertices.max(axis=0)
    person = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    person[:, 1] += low[1] - person[:, 1].min()
    person[:, 0] += high[0] + gap - person[:, 0].min()
    points = np.concatenate([exemplar.vertices, person])
    points -= (points.min(axis=0) + points.max(axis=0)) / 2
    parts = np.full(len(faces), len(exemplar.part_names))
    return Exemplar(
        exemplar.name,
        exemplar.category,
        points,
        np.concatenate([exemplar.faces, faces + len(exemplar.vertices)]),
        (*exemplar.part_names, PERSON),
        np.concatenate([exemplar.face_parts, parts]),
    )


def standing_person(height: float = 1.7) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) in metres (y up, front +z) and faces of the embedded body, arms hanging."""
    import torch

    from hoi.actions.authoring import Description, pose_from_description
    from hoi.body import DEFAULT_BODY, BodyModel

    model = BodyModel.load(DEFAULT_BODY)
    pose = torch.as_tensor(pose_from_description(Description()), dtype=torch.float32)[None]
    zeros = torch.zeros(1, 3)
    with torch.no_grad():
        vertices, _ = model(zeros, pose, torch.zeros(1, model.num_betas), zeros)
    points = vertices[0].numpy()
    return points * (height / np.ptp(points[:, 1])), np.asarray(model.faces)
