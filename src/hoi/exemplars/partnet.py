"""PartNet v0 and PartNet-Mobility folders: part-labelled raw meshes and labelled points.

A shape is a folder ``<root>/<anno_id>/`` with ``meta.json`` (its category), ``result.json`` (the
tree as annotated), ``result_after_merging.json`` (the final tree, whose nodes name the annotated
node they come from in ``ori_id``) and the pieces in ``objs/`` (Mobility: ``textured_objs/``).
Labels of sampled points are ids of leaves of ``result.json``. Shapes are y up in a unit sphere.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hoi.errors import AssetError
from hoi.exemplars.sweethome import parse_obj
from hoi.exemplars.vocabulary import PARTNET_CATEGORY, as_part, partnet_parts

_PIECES = ("objs", "textured_objs")
_NAME = re.compile(r"[\w][\w.\-]*")
_POINTS = "point_sample/sample-points-all-pts-nor-rgba-10000.txt"
_POINT_LABELS = "point_sample/sample-points-all-label-10000.txt"
_PART_POINTS = "point_sample/pts-10000.txt"
_PART_POINT_LABELS = "point_sample/label-10000.txt"
_MAX_NODES = 20_000


class LabelledSoup(NamedTuple):
    """vertices (V, 3), faces (F, 3) int64, part_names, face_parts (F,), in the file's frame."""

    vertices: np.ndarray
    faces: np.ndarray
    part_names: tuple[str, ...]
    face_parts: np.ndarray


@dataclass(frozen=True)
class LabelledPoints:
    """Sampled points of a shape.

    `points` (N, 3) and `normals` (N, 3) or None in the file's frame, `leaf_ids` (N,) ids of
    ``result.json``, `paths` (N,) the final tree's path of each, e.g.
    ``chair/chair_seat/seat_surface``; empty where the final tree dropped the piece.
    """

    points: np.ndarray
    normals: np.ndarray | None
    leaf_ids: np.ndarray
    paths: np.ndarray


@dataclass(frozen=True)
class _Node:
    """A node of an annotation tree and the path of names that leads to it."""

    path: tuple[str, ...]
    id: int
    ori_id: int
    objs: tuple[str, ...]
    leaf: bool


def read_shape(folder: Path, noun: str) -> LabelledSoup | None:
    """All pieces of a shape with the part that each face belongs to.

    Parts are named as the rest of the library names them, e.g. ``chair_seat``: the first name on
    the path that PartNet lists right below the object, else the last one.

    Returns None when the shape's own names say that it is no `noun`: a bag that is a suitcase and
    no backpack, a chair without a back where stools are wanted.

    Raises AssetError naming file and key.
    """
    raw = _tree(folder / "result.json")
    merged_file = folder / "result_after_merging.json"
    merged = _tree(merged_file) if merged_file.is_file() else []
    parts = _part_of_piece(raw, merged, noun)
    if not _is_noun(noun, raw, set(parts.values())):
        return None
    pieces = _pieces_folder(folder)
    vertices, faces, labels, count = [], [], [], 0
    names = tuple(dict.fromkeys(parts.values()))
    for piece, part in parts.items():
        points, triangles = _read_piece(pieces, piece, folder / "result.json")
        vertices.append(points)
        faces.append(triangles + count)
        labels.append(np.full(len(triangles), names.index(part), np.int64))
        count += len(points)
    if not faces:
        raise AssetError(f"{folder / 'result.json'}: its key 'objs' names no piece at all")
    return LabelledSoup(
        np.concatenate(vertices), np.concatenate(faces), names, np.concatenate(labels)
    )


def read_points(folder: Path) -> LabelledPoints:
    """The sampled points of a shape, their labels mapped to the final tree through ``ori_id``.

    Raises AssetError naming file and key or line.
    """
    raw = _tree(folder / "result.json")
    merged = _tree(folder / "result_after_merging.json")
    table = _numbers(folder / _POINTS, 6, required=False)
    labels = _numbers(folder / _POINT_LABELS, 1, required=table is not None)
    normals = None if table is None else table[:, 3:6]
    if table is None or labels is None:
        table = _numbers(folder / _PART_POINTS, 3)
        labels = _numbers(folder / _PART_POINT_LABELS, 1)
    assert table is not None and labels is not None
    if len(table) != len(labels):
        raise AssetError(f"{folder}/point_sample: {len(table)} points, {len(labels)} labels")
    leaf_ids = labels[:, 0].astype(np.int64)
    known = {node.id for node in raw}
    foreign = np.setdiff1d(leaf_ids, sorted(known))
    if len(foreign):
        raise AssetError(
            f"{folder}/point_sample: label {foreign[0]} is no id of {folder / 'result.json'}"
        )
    paths = {leaf: "/".join(path) for leaf, path in _merged_path_of_leaf(raw, merged).items()}
    named = np.array([paths.get(int(leaf), "") for leaf in leaf_ids])
    return LabelledPoints(table[:, :3], normals, leaf_ids, named)


def input_files(folder: Path) -> list[Path]:
    """The existing files that :func:`read_shape` depends on, sorted."""
    found = [folder / name for name in ("result.json", "result_after_merging.json")]
    for name in _PIECES:
        if (folder / name).is_dir():
            found += sorted((folder / name).glob("*.obj"))
            break
    return [path for path in found if path.is_file()]


# ------------------------------------------------------------------------------------- names


def _part_of_piece(raw: list[_Node], merged: list[_Node], noun: str) -> dict[str, str]:
    """Piece (file stem) -> part name, in the order of the annotation."""
    path_of_leaf = _merged_path_of_leaf(raw, merged)
    listed = {piece: node.path for node in merged for piece in node.objs}  # deeper nodes come later
    parts: dict[str, str] = {}
    for node in raw:
        for piece in node.objs if node.leaf else ():
            path = path_of_leaf.get(node.id) or listed.get(piece) or node.path
            parts.setdefault(piece, part_name(path, noun))
    return parts


def _merged_path_of_leaf(raw: list[_Node], merged: list[_Node]) -> dict[int, tuple[str, ...]]:
    """Leaf id of ``result.json`` -> path of the deepest final node that covers it."""
    leaves_below: dict[int, list[int]] = {}
    trail: list[tuple[int, int]] = []  # (depth, id) of the ancestors of the node at hand
    for node in raw:
        depth = len(node.path)
        trail = [(d, i) for d, i in trail if d < depth]
        trail.append((depth, node.id))
        if node.leaf:
            for _, ancestor in trail:
                leaves_below.setdefault(ancestor, []).append(node.id)
    found: dict[int, tuple[str, ...]] = {}
    for node in merged:  # parents come before children
        for leaf in leaves_below.get(node.ori_id, ()):
            if len(node.path) >= len(found.get(leaf, ())):
                found[leaf] = node.path
    return found


def part_name(path: Iterable[str], noun: str) -> str:
    """The part that a path of names stands for: ``bag/bag_body/...`` -> ``bag_body``."""
    names = [as_part(name) for name in path]
    category = PARTNET_CATEGORY.get(noun)
    coarse = partnet_parts(category)["level1"] if category else ()
    for name in names:
        if name in coarse:
            return name
    return names[-1]


def _is_noun(noun: str, raw: list[_Node], parts: set[str]) -> bool:
    """Whether a shape of the noun's PartNet category is one of these objects."""
    names = {as_part(name) for node in raw for name in node.path}
    if noun == "stool":
        return "chair_back" not in parts
    if noun == "chair":
        return "chair_back" in parts or not any(name.startswith("chair_") for name in parts)
    kinds = {"backpack": {"backpack"}, "suitcase": {"luggage", "briefcase", "suitcase"}}
    others = {"backpack", "luggage", "briefcase", "suitcase", "hand_or_shoulder_bag", "paper_bag"}
    if noun not in kinds or not names & others:
        return True
    return bool(names & kinds[noun])


# ------------------------------------------------------------------------------------- files


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise AssetError(f"{path}: no such file; is its folder a shape of PartNet?") from None
    except (OSError, ValueError, RecursionError) as error:
        raise AssetError(f"{path}: not readable as JSON: {error}") from error


def _entry(mapping: dict[str, Any], key: str, kind: type, path: Path) -> Any:
    value = mapping.get(key)
    if not isinstance(value, kind) or isinstance(value, bool):
        state = "is missing" if key not in mapping else f"is {value!r}"
        raise AssetError(f"{path}: key {key!r} {state}, expected {kind.__name__}")
    return value


def _tree(path: Path) -> list[_Node]:
    """The nodes of an annotation tree, parents before children."""
    content = _json(path)
    if not isinstance(content, list) or not content:
        raise AssetError(f"{path}: expected a list with the root of the tree")
    nodes: list[_Node] = []
    for node in _walk(content, (), path):
        nodes.append(node)
        if len(nodes) > _MAX_NODES:
            raise AssetError(f"{path}: more than {_MAX_NODES} nodes; the file is damaged")
    return nodes


def _walk(entries: list[Any], path: tuple[str, ...], file: Path) -> Iterator[_Node]:
    for entry in entries:
        if not isinstance(entry, dict):
            raise AssetError(f"{file}: a node under {'/'.join(path) or 'the root'} is no object")
        name, number = _entry(entry, "name", str, file), _entry(entry, "id", int, file)
        children = entry.get("children", [])
        if not isinstance(children, list):
            raise AssetError(f"{file}: key 'children' of node {number} is no list")
        origin = _entry(entry, "ori_id", int, file) if "ori_id" in entry else number
        here = (*path, name)
        yield _Node(here, number, origin, _piece_names(entry, number, file), not children)
        yield from _walk(children, here, file)


def _piece_names(entry: dict[str, Any], number: int, file: Path) -> tuple[str, ...]:
    pieces = entry.get("objs", [])
    if not isinstance(pieces, list):
        raise AssetError(f"{file}: key 'objs' of node {number} is no list")
    for piece in pieces:
        if not isinstance(piece, str) or not _NAME.fullmatch(piece):
            raise AssetError(
                f"{file}: key 'objs' of node {number} names {piece!r}, which is no file name of "
                "letters, digits, dots and dashes; refused, a piece lies in the shape's own folder"
            )
    return tuple(pieces)


def _pieces_folder(folder: Path) -> Path:
    for name in _PIECES:
        if (folder / name).is_dir():
            return folder / name
    raise AssetError(f"{folder}: has neither objs/ nor textured_objs/")


def _read_piece(pieces: Path, piece: str, tree: Path) -> tuple[np.ndarray, np.ndarray]:
    path = pieces / f"{piece}.obj"
    if not path.resolve().is_relative_to(pieces.resolve()):
        raise AssetError(f"{path}: leads out of its folder; refused")
    if not path.is_file():
        raise AssetError(f"{path}: no such file, yet key 'objs' of {tree} names it")
    return read_obj(path)


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """vertices (V, 3) and faces (F, 3) of an OBJ file; raises AssetError naming it."""
    try:
        vertices, faces, _ = parse_obj(path.read_text(encoding="utf-8", errors="replace"))
    except (OSError, ValueError, OverflowError) as error:
        raise AssetError(f"{path}: cannot be read as a mesh: {error}") from error
    if not np.isfinite(vertices).all():
        raise AssetError(f"{path}: a vertex is NaN or infinite")
    return vertices, faces


def _numbers(path: Path, columns: int, required: bool = True) -> np.ndarray | None:
    """(N, >= columns) numbers of a text file, None when it is not there and not required."""
    if not path.is_file():
        if required:
            raise AssetError(f"{path}: no such file; many Mobility shapes come without points")
        return None
    try:
        table = np.loadtxt(path, dtype=np.float64, ndmin=2, encoding="utf-8")
    except (OSError, ValueError) as error:
        raise AssetError(f"{path}: not a table of numbers: {error}") from error
    if table.shape[1] < columns or not len(table) or not np.isfinite(table).all():
        raise AssetError(f"{path}: expected {columns} finite numbers a line, found {table.shape}")
    return table
