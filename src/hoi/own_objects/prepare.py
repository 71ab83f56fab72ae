"""A mesh file -> a watertight, metric, upright, part-labelled exemplar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoi.errors import AssetError, ConfigError
from hoi.exemplars.labelling import label_faces
from hoi.exemplars.library import Exemplar
from hoi.exemplars.remesh import watertight_remesh
from hoi.own_objects.description import OwnMesh
from hoi.own_objects.mesh_file import (
    REST,
    label_regions,
    parts_of_groups,
    read_labels,
    read_mesh_file,
)
from hoi.own_objects.orientation import canonical_from_file, guess_orientation, surface_points

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
_PLAUSIBLE_METRES = (0.02, 5.0)  # longest side of what a person handles
_MOST_PARTS = 60


@dataclass(frozen=True)
class MeshOptions:
    """What a user says of a mesh; everything else is found out.

    Attributes:
        up, front: the file's axes (``z``, ``-y``), None to guess.
        unit: m, cm, mm, in or ft; None for the unit that makes the size plausible.
        size_m: wanted size in metres, which overrules the unit.
        size_axis: the extent that `size_m` measures.
        groups: group name -> part name.
        labels: text file with a part name for every face.
        regions: geometric rules, see :func:`hoi.own_objects.mesh_file.label_regions`.
        vertices: wanted vertex count.
    """

    up: str | None = None
    front: str | None = None
    unit: str | None = None
    size_m: float | None = None
    size_axis: str = "longest"
    groups: Mapping[str, str] = field(default_factory=dict)
    labels: Path | None = None
    regions: Sequence[str] = ()
    vertices: int = 1000


class Prepared(NamedTuple):
    """An exemplar, how its file was read, and what a user should know of it."""

    exemplar: Exemplar
    origin: OwnMesh
    notes: tuple[str, ...]


def prepare_mesh(path: Path | str, category: str, name: str, options: MeshOptions) -> Prepared:
    """Read, orient, scale, re-mesh and label one mesh file.

    Raises AssetError for a file that cannot be used, ConfigError for an option that does not fit.
    """
    from hoi.digest import file_digest

    path = Path(path)
    mesh = read_mesh_file(path)
    points = surface_points(mesh.vertices, mesh.faces)
    orientation = guess_orientation(points, path.suffix, options.up, options.front)
    vertices = mesh.vertices @ canonical_from_file(orientation.up, orientation.front).T
    extent = np.ptp(vertices[np.unique(mesh.faces)], axis=0)
    metres, unit_note = _unit(path, extent, options)
    try:
        points, triangles, nearest = watertight_remesh(
            vertices * metres, mesh.faces, options.vertices
        )
    except AssetError as error:
        raise AssetError(f"{path}: {error}") from error
    points -= (points.min(axis=0) + points.max(axis=0)) / 2
    labels, label_note = _labels(path, mesh, options)
    names, parts = _parts(category, labels, nearest, points, triangles, options)
    if len(names) > _MOST_PARTS:
        raise ConfigError(
            f"{path}: {len(names)} parts are too many; name the ones that people touch with "
            "--part GROUP=PART, or draw regions with --region"
        )
    origin = OwnMesh(
        file=path.name,
        sha256=file_digest(path),
        up=orientation.up,
        front=orientation.front,
        unit_metres=float(f"{metres:.6g}"),
    )
    exemplar = Exemplar(name, category, points, triangles, names, parts, "own object", "own mesh")
    return Prepared(exemplar, origin, (orientation.reason, unit_note, label_note))


def _unit(path: Path, extent: np.ndarray, options: MeshOptions) -> tuple[float, str]:
    """Metres of the file's unit, and where that comes from."""
    longest = float(extent.max())
    if options.size_m is not None:
        measured = float(extent[1]) if options.size_axis == "height" else longest
        if not measured > 0:
            raise ConfigError(f"{path}: it has no height; give its size as its longest side")
        return options.size_m / measured, f"scaled to {options.size_m:g} m ({options.size_axis})"
    low, high = _PLAUSIBLE_METRES
    names = [options.unit] if options.unit else list(UNITS)
    for name in names:
        if name not in UNITS:
            raise ConfigError(f"{name!r} is no unit: use one of {', '.join(UNITS)}")
        if low <= longest * UNITS[name] <= high:
            return UNITS[name], f"its unit is taken to be 1 {name}"
    raise AssetError(
        f"{path}: its longest side is {longest:.4g} units, which is no plausible size"
        f"{f' in {options.unit}' if options.unit else ''}; say how large it is with --size METRES"
    )


def _labels(path: Path, mesh, options: MeshOptions) -> tuple[np.ndarray, str]:
    """A part name for every face of the file; all ``rest`` where nothing tells."""
    if options.labels is not None:
        return read_labels(options.labels, len(mesh.faces)), f"parts from {options.labels.name}"
    parts = parts_of_groups(mesh.groups, options.groups, path)
    named = sorted(set(parts.tolist()) - {REST})
    return parts, f"parts from its groups: {', '.join(named)}" if named else "no named groups"


def _parts(
    category: str,
    labels: np.ndarray,
    nearest: np.ndarray,
    vertices: np.ndarray,
    faces: np.ndarray,
    options: MeshOptions,
) -> tuple[tuple[str, ...], np.ndarray]:
    """Part names and face labels of the new mesh: names of the file, else the category's rule."""
    parts = labels[nearest]
    if (parts == REST).all():
        names, index = label_faces(category, vertices, faces)
        parts = np.array(names)[index]
    centres = vertices[faces].mean(axis=1)
    parts = label_regions(parts, centres, options.regions)
    names, index = np.unique(parts, return_inverse=True)
    return tuple(str(name) for name in names), index
