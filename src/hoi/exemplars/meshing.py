"""Part-labelled solids -> one watertight mesh of about a thousand even vertices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from manifold3d import Manifold, OpType


class LabelledMesh(NamedTuple):
    """vertices (V, 3) float32 m, faces (F, 3) int64, part_names, face_parts (F,) int64."""

    vertices: np.ndarray
    faces: np.ndarray
    part_names: tuple[str, ...]
    face_parts: np.ndarray


def union_of_parts(parts: Mapping[str, Sequence[Manifold]], vertices: int) -> LabelledMesh:
    """Unite the solids of all parts and subdivide to about `vertices` vertices.

    The union is watertight. Labels are exact: the union remembers for each triangle the solid
    it was cut from. The result is centred on its bounding box. Parts without solids are left out.
    """
    names = tuple(name for name, solids in parts.items() if solids)
    originals = [(index, s.as_original()) for index, name in enumerate(names) for s in parts[name]]
    label_of = {solid.original_id(): index for index, solid in originals}
    whole = Manifold.batch_boolean([solid for _, solid in originals], OpType.Add)
    mesh = refine_to_count(whole, vertices).to_mesh()
    face_parts = np.repeat(
        [label_of[i] for i in mesh.run_original_id], np.diff(mesh.run_index) // 3
    )
    points = np.asarray(mesh.vert_properties)[:, :3]
    points = (points - (points.min(axis=0) + points.max(axis=0)) / 2).astype(np.float32)
    # A part wholly inside another leaves no face; it must leave no name either.
    used = np.unique(face_parts)
    return LabelledMesh(
        points,
        np.asarray(mesh.tri_verts, np.int64),
        tuple(names[i] for i in used),
        np.searchsorted(used, face_parts),
    )


def refine_to_count(solid: Manifold, vertices: int) -> Manifold:
    """Split long edges until the solid has about `vertices` vertices (never fewer than it has).

    The longest allowed edge is found by bisection on a log scale.
    """
    extent = np.asarray(solid.bounding_box(), float)
    longest = float(np.linalg.norm(extent[3:] - extent[:3]))
    low, high = longest / 200, longest
    best = solid
    for _ in range(12):
        length = float(np.sqrt(low * high))
        refined = solid.refine_to_length(length)
        if abs(refined.num_vert() - vertices) < abs(best.num_vert() - vertices):
            best = refined
        if abs(best.num_vert() - vertices) <= 0.03 * vertices:
            break
        if refined.num_vert() > vertices:
            low = length
        else:
            high = length
    return best


def warped(vertices: np.ndarray, amplitude: float, seed: int) -> np.ndarray:
    """Deform a shape smoothly: a sum of three long waves, `amplitude` as a share of its size.

    Waves are longer than the object, so neighbouring points keep their order and closed meshes
    stay closed.
    """
    random = np.random.default_rng(seed)
    size = np.ptp(vertices, axis=0)
    unit = (vertices / size).astype(np.float64)
    moved = np.zeros_like(unit)
    for _ in range(3):
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        phase, push = random.uniform(0, 2 * np.pi), random.normal(size=3)
        wave = np.sin(1.6 * np.pi * unit @ direction + phase)
        moved += wave[:, None] * push / np.linalg.norm(push)
    return (vertices + amplitude * size * moved).astype(np.float32)
