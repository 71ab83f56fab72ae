"""A user's own meshes as exemplar candidates.

Format: ``<folder>/<category>/*`` with one object a file (.obj, .glb, .gltf, .ply, .stl, .off).
Parts are the named groups of an OBJ (``g``/``o``) or the nodes of a GLB whose names are in the
vocabulary of the category (``chair_seat``, ``chair_seat.001``, ``Chair Seat 2``). Without such
names chairs, stools and tables are divided by geometric rules; anything else is one part,
``whole``. Meshes need not be watertight: all are re-meshed.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoi.errors import AssetError, ConfigError
from hoi.exemplars.config import ExemplarsConfig
from hoi.exemplars.labelling import label_faces
from hoi.exemplars.library import Exemplar
from hoi.exemplars.remesh import remesh
from hoi.exemplars.sweethome import parse_obj
from hoi.exemplars.vocabulary import as_part, part_names

SUFFIXES = (".obj", ".glb", ".gltf", ".ply", ".stl", ".off")
_PLAUSIBLE_METRES = (0.005, 15.0)


def load_own_meshes(config: ExemplarsConfig, category: str) -> list[Exemplar]:
    """All meshes of ``<config.folder>/<category>``, in order of their names.

    An absent category folder gives an empty list. Raises ConfigError when the folder itself is
    not named or absent, AssetError naming a file that cannot be used.
    """
    root = Path(config.folder)
    if not config.folder or not root.is_dir():
        raise ConfigError(
            f"exemplars.folder is {config.folder!r}: source `folder` needs an existing folder"
        )
    files = sorted(f for f in (root / category).glob("*") if f.suffix.lower() in SUFFIXES)
    return [load_own_mesh(file, category, config) for file in files]


def load_own_mesh(path: Path, category: str, config: ExemplarsConfig) -> Exemplar:
    """One mesh file as a watertight, metric, part-labelled exemplar in the canonical frame."""
    try:
        vertices, faces, groups = _read(path, category)
    except Exception as error:  # the readers raise many kinds for damaged files
        raise AssetError(f"{path} cannot be read as a mesh: {error}") from error
    vertices = _canonical(vertices, config)
    longest = float(np.ptp(vertices[np.unique(faces)], axis=0).max())
    if not _PLAUSIBLE_METRES[0] <= longest <= _PLAUSIBLE_METRES[1]:
        raise AssetError(
            f"{path} is {longest:.4g} m long; set exemplars.folder_unit_metres to the length of "
            "its unit (0.01 for centimetres, 0.001 for millimetres)"
        )
    try:
        points, triangles, nearest = remesh(vertices, faces, config.remesh, config.vertices)
    except AssetError as error:
        raise AssetError(f"{path}: {error}") from error
    points -= (points.min(axis=0) + points.max(axis=0)) / 2
    names, parts = _parts(category, groups[nearest], points, triangles)
    return Exemplar(path.stem, category, points, triangles, names, parts, "folder", "own mesh")


def _read(path: Path, category: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """vertices (V, 3), faces (F, 3), group name (F,) in the file's own frame and unit.

    A node's own name counts when it names a part of the category, else its mesh's name.
    """
    if path.suffix.lower() == ".obj":
        return parse_obj(path.read_text(encoding="utf-8", errors="replace"))
    pieces = scene_pieces(path)
    groups: list[str] = []
    for piece in pieces:
        named = as_part(piece.node) in part_names(category)
        groups += [piece.node if named else piece.geometry] * len(piece.faces)
    return (*joined(pieces), np.array(groups))


class ScenePiece(NamedTuple):
    """One mesh of a scene file where its node places it: vertices (V, 3), own faces (F, 3)."""

    vertices: np.ndarray
    faces: np.ndarray
    node: str
    geometry: str
    material: str  # empty: it has no name


def scene_pieces(path: Path) -> list[ScenePiece]:
    """All meshes of a glb, gltf, ply, stl or off file; raises ValueError when there is none."""
    import trimesh

    scene = trimesh.load_scene(path, process=False)
    pieces = []
    for node in scene.graph.nodes_geometry:
        transform, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        material = getattr(getattr(mesh.visual, "material", None), "name", None)
        points = trimesh.transform_points(mesh.vertices, transform)
        faces = np.asarray(mesh.faces)
        pieces.append(ScenePiece(points, faces, str(node), str(geometry), str(material or "")))
    if not pieces:
        raise ValueError("no triangles")
    return pieces


def joined(pieces: Sequence[ScenePiece]) -> tuple[np.ndarray, np.ndarray]:
    """vertices (V, 3) and faces (F, 3) of all pieces as one mesh."""
    starts = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    faces = [piece.faces + start for piece, start in zip(pieces, starts, strict=False)]
    return np.concatenate([piece.vertices for piece in pieces]), np.concatenate(faces)


def _canonical(vertices: np.ndarray, config: ExemplarsConfig) -> np.ndarray:
    """The file's frame and unit -> y up, front +z, metres."""
    points = np.asarray(vertices, np.float64) * config.folder_unit_metres
    if config.folder_up == "z":
        points = points[:, [0, 2, 1]] * (1, 1, -1)
    return points @ about_y(config.folder_yaw_degrees).T


def about_y(degrees: float) -> np.ndarray:
    """(3, 3) rotation about y; 90 degrees bring +z to +x and +x to -z."""
    yaw = np.radians(degrees)
    return np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])


def _parts(
    category: str, groups: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> tuple[tuple[str, ...], np.ndarray]:
    """Part names and face labels from group names, else from geometry."""
    labels = np.array([as_part(group) for group in groups])
    if not np.isin(labels, part_names(category)).any():
        return label_faces(category, vertices, faces)
    names, parts = np.unique(labels, return_inverse=True)
    return tuple(str(name) for name in names), parts
