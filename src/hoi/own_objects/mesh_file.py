"""Reading a mesh file with the names of its pieces, and the labels that a user gives them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoi.errors import AssetError, ConfigError
from hoi.exemplars.vocabulary import as_part

SUFFIXES = (".obj", ".glb", ".gltf", ".ply", ".stl", ".off")
REST = "rest"
_NOT_NAMES = re.compile(
    r"(unnamed|default|scene|root|world|node|mesh|object|geometry|group|part|component|solid|shape|"
    r"material|mat|primitive|polysurface|cube|plane|sphere|cylinder|circle|torus|cone|icosphere|"
    r"curve|\d+)(_?\d+)*"
)
_RULE = re.compile(r"([xyz])\s*(<|>)\s*(-?\d*\.?\d+)")


class MeshFile(NamedTuple):
    """vertices (V, 3) in the file's frame and unit, faces (F, 3), group name of each face (F,)."""

    vertices: np.ndarray
    faces: np.ndarray
    groups: np.ndarray


def read_mesh_file(path: Path | str) -> MeshFile:
    """The triangles of a file, with the name of the group, node or material each belongs to.

    Node names count before mesh names, and material names where all nodes have one name. Raises
    AssetError naming the file when it is absent, of an unknown kind, damaged or empty.
    """
    path = Path(path)
    if not path.is_file():
        raise AssetError(f"{path}: there is no such file")
    if path.suffix.lower() not in SUFFIXES:
        raise AssetError(f"{path}: a {', '.join(SUFFIXES)} file is expected")
    try:
        read = _read_obj if path.suffix.lower() == ".obj" else _read_scene
        mesh = read(path)
    except Exception as error:  # the readers raise many kinds for damaged files
        raise AssetError(f"{path}: cannot be read as a mesh: {error}") from error
    points = mesh.vertices[np.unique(mesh.faces)]
    if not np.isfinite(points).all():
        raise AssetError(f"{path}: vertices hold NaN or infinity")
    if not np.ptp(points, axis=0).max() > 0:
        raise AssetError(f"{path}: the mesh has no extent")
    return mesh


def _read_obj(path: Path) -> MeshFile:
    from hoi.exemplars.sweethome import parse_obj

    text = path.read_text(encoding="utf-8", errors="replace")
    mesh = MeshFile(*parse_obj(text))
    if len(np.unique(mesh.groups)) > 1:
        return mesh
    # one group: materials may tell the parts apart
    lines = text.splitlines()
    renamed = [
        "g " + line[7:] if line.startswith("usemtl ") else line
        for line in lines
        if line[:2] not in ("g ", "o ")
    ]
    by_material = MeshFile(*parse_obj("\n".join(renamed)))
    return by_material if len(np.unique(by_material.groups)) > 1 else mesh


def _read_scene(path: Path) -> MeshFile:
    from hoi.exemplars.own_meshes import joined, scene_pieces

    pieces = scene_pieces(path)

    def each_face(names: Sequence[str]) -> list[str]:
        sizes = [len(piece.faces) for piece in pieces]
        return [name for name, size in zip(names, sizes, strict=True) for _ in range(size)]

    kinds = (
        each_face([piece.node for piece in pieces]),
        each_face([piece.geometry for piece in pieces]),
        each_face([piece.material for piece in pieces]),
    )
    return MeshFile(*joined(pieces), np.array(max(kinds, key=_telling)))


def _telling(groups: Sequence[str]) -> int:
    """How many real part names are among group names; the first kind wins a tie."""
    return len({as_part(group) for group in set(groups) if is_name(as_part(group))})


def is_name(part: str) -> bool:
    """Whether a group's name says something: not ``Cube.003``, ``mesh_0``, ``Material 2``."""
    return not _NOT_NAMES.fullmatch(part)


def parts_of_groups(
    groups: np.ndarray, renamed: Mapping[str, str], path: Path | str = ""
) -> np.ndarray:
    """(F,) part name of each face from its group's name; ``rest`` where that says nothing.

    Args:
        groups: (F,) names as the file spells them.
        renamed: group -> part, as a user says; spelling and numbers at the end do not count.
        path: of the file, for messages.

    Raises ConfigError for a renamed group that the file does not have.
    """
    wanted = {as_part(group): as_part(part) for group, part in renamed.items()}
    exact = {group: as_part(part) for group, part in renamed.items()}
    known = set(np.unique(groups).tolist())
    unknown = [g for g in renamed if g not in known and as_part(g) not in map(as_part, known)]
    if unknown:
        raise ConfigError(
            f"{path}: it has no group {', '.join(map(repr, unknown))}; "
            f"its groups are {', '.join(map(repr, sorted(known)))}"
        )

    def part_of(group: str) -> str:
        part = as_part(group)
        return exact.get(group) or wanted.get(part) or (part if is_name(part) else REST)

    table = {group: part_of(group) for group in known}
    return np.array([table[group] for group in groups.tolist()])


def read_labels(path: Path | str, faces: int) -> np.ndarray:
    """(F,) part names from a text file with one name a line, in the order of the file's faces.

    Raises AssetError when it is absent or has another number of lines.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise AssetError(f"{path}: not a readable list of labels: {error}") from error
    if len(lines) != faces:
        raise AssetError(
            f"{path}: {len(lines)} lines for {faces} triangles; one part name a line is expected, "
            "polygons counting as fans of triangles"
        )
    return np.array([as_part(line) for line in lines])


def label_regions(parts: np.ndarray, centres: np.ndarray, regions: Sequence[str]) -> np.ndarray:
    """Relabel the faces inside boxes: a geometric rule in one line.

    Args:
        parts: (F,) part names.
        centres: (F, 3) face centres in the canonical frame.
        regions: ``part: y>0.8, z<0.3``: the part's name, then bounds in shares of the bounding
            box (x from the object's right to its left, y up, z to the front). Later ones win.

    Raises ConfigError for a rule that cannot be read or catches no face.
    """
    low, high = centres.min(axis=0), centres.max(axis=0)
    shares = (centres - low) / np.maximum(high - low, 1e-9)
    parts = parts.astype(object)
    for rule in regions:
        name, _, bounds = rule.partition(":")
        tests = [text.strip() for text in bounds.split(",") if text.strip()]
        matches = [_RULE.fullmatch(test) for test in tests]
        if not name.strip() or not tests or not all(matches):
            raise ConfigError(f"region {rule!r}: write it as 'handle: y>0.8, z<0.3'")
        inside = np.ones(len(parts), bool)
        for match in matches:
            assert match is not None
            axis, sign, value = match.groups()
            share = shares[:, "xyz".index(axis)]
            inside &= share > float(value) if sign == ">" else share < float(value)
        if not inside.any():
            raise ConfigError(f"region {rule!r} holds no part of the mesh; see the picture's axes")
        parts[inside] = as_part(name)
    return parts.astype(str)
