"""The exemplar: a metric, watertight, part-labelled mesh; and the file that holds a category's.

A library is a folder of ``<category>.npz`` files. Nothing in them is pickled and equal exemplars
give equal bytes, so the sha256 of a file identifies what the stages saw.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoi.errors import AssetError

_FORMAT = "hoi exemplars 1"
_TIMESTAMP = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, eq=False)
class Exemplar:
    """One object of a category in its canonical frame (y up, front +z, metres, bbox-centred).

    Args:
        name: unique within the category, e.g. ``procedural_chair_003`` or ``CC0_79``.
        category: lower-case noun, e.g. ``chair``.
        vertices: (V, 3) float32, metres; the bounding box is centred on the origin.
        faces: (F, 3) int64, outward orientation.
        part_names: labels in the vocabulary of `hoi.exemplars.vocabulary`.
        face_parts: (F,) int64 index into `part_names`.
        source: where the mesh comes from (``procedural``, ``furniture``, ``folder``).
        licence: licence and creator in a few words.

    Raises ValueError when the arrays do not fit together.
    """

    name: str
    category: str
    vertices: np.ndarray
    faces: np.ndarray
    part_names: tuple[str, ...]
    face_parts: np.ndarray
    source: str = ""
    licence: str = ""

    def __post_init__(self) -> None:
        fix = object.__setattr__
        fix(self, "vertices", np.ascontiguousarray(self.vertices, np.float32))
        fix(self, "faces", np.ascontiguousarray(self.faces, np.int64))
        fix(self, "face_parts", np.ascontiguousarray(self.face_parts, np.int64))
        fix(self, "part_names", tuple(self.part_names))
        problem = _inconsistency(self)
        if problem:
            raise ValueError(f"exemplar {self.name!r}: {problem}")

    @property
    def size(self) -> np.ndarray:
        """(3,) width, height, depth of the bounding box in metres."""
        return np.ptp(self.vertices, axis=0)

    @cached_property
    def geometry_hash(self) -> str:
        """sha256 of the shape alone (vertices rounded to 0.1 mm, and faces)."""
        grid = np.round(self.vertices.astype(np.float64) * 1e4).astype(np.int32)
        return hashlib.sha256(grid.tobytes() + self.faces.tobytes()).hexdigest()

    @property
    def vertex_parts(self) -> np.ndarray:
        """(V,) part index of each vertex: the lowest part index among its faces."""
        parts = np.full(len(self.vertices), len(self.part_names), np.int64)
        np.minimum.at(parts, self.faces.ravel(), np.repeat(self.face_parts, 3))
        return parts

    def part_vertices(self, part: str) -> np.ndarray:
        """Sorted indices of the vertices that touch a face of `part` (empty: no such part)."""
        if part not in self.part_names:
            return np.zeros(0, np.int64)
        return np.unique(self.faces[self.face_parts == self.part_names.index(part)])


class SurfaceSamples(NamedTuple):
    """Points drawn uniformly by area: points (N, 3) m, unit normals (N, 3), float32."""

    points: np.ndarray
    normals: np.ndarray


def sample_parts(exemplar: Exemplar, n: int, seed: int) -> dict[str, SurfaceSamples]:
    """Draw `n` area-uniform surface points with outward normals from every part.

    A part of no area is left out. Same seed, same points.
    """
    generator = np.random.default_rng(seed)
    triangles = exemplar.vertices.astype(np.float64)[exemplar.faces]
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    doubled_area = np.linalg.norm(cross, axis=1)
    samples = {}
    for index, part in enumerate(exemplar.part_names):
        weight = np.where(exemplar.face_parts == index, doubled_area, 0.0)
        if weight.sum() <= 0:
            continue
        chosen = generator.choice(len(weight), size=n, p=weight / weight.sum())
        u, v = generator.random((2, n))
        u, v = np.where(u + v > 1, 1 - u, u)[:, None], np.where(u + v > 1, 1 - v, v)[:, None]
        a, b, c = triangles[chosen].transpose(1, 0, 2)
        points = a + u * (b - a) + v * (c - a)
        normals = cross[chosen] / doubled_area[chosen, None]
        samples[part] = SurfaceSamples(points.astype(np.float32), normals.astype(np.float32))
    return samples


def library_path(exemplars_dir: Path | str, category: str) -> Path:
    """The file of one category in a library folder."""
    return Path(exemplars_dir) / f"{category}.npz"


def save_library(exemplars: Sequence[Exemplar], path: Path | str) -> str:
    """Write exemplars of one category to one file; returns the sha256 of its bytes."""
    path = Path(path)
    if not exemplars:
        raise ValueError(f"no exemplars to write to {path}")
    meta = {
        "format": _FORMAT,
        "exemplars": [
            {
                "name": exemplar.name,
                "category": exemplar.category,
                "part_names": exemplar.part_names,
                "source": exemplar.source,
                "licence": exemplar.licence,
            }
            for exemplar in exemplars
        ],
    }
    text = json.dumps(meta, sort_keys=True, ensure_ascii=False)
    arrays = {
        "meta": np.frombuffer(text.encode(), np.uint8),
        "vertex_counts": np.array([len(e.vertices) for e in exemplars], np.int32),
        "face_counts": np.array([len(e.faces) for e in exemplars], np.int32),
        "vertices": np.concatenate([e.vertices for e in exemplars]),
        "faces": np.concatenate([e.faces for e in exemplars]).astype(np.int32),
        "face_parts": np.concatenate([e.face_parts for e in exemplars]).astype(np.uint8),
    }
    data = _npz_bytes(arrays)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(data)
    partial.replace(path)
    return hashlib.sha256(data).hexdigest()


def load_library(exemplars_dir: Path | str, category: str) -> list[Exemplar]:
    """Read ``<exemplars_dir>/<category>.npz``; raises AssetError when absent or damaged."""
    path = library_path(exemplars_dir, category)
    exemplars = load_library_file(path)
    foreign = [e.name for e in exemplars if e.category != category]
    if foreign:
        raise AssetError(f"{path} holds objects that are no {category}: {', '.join(foreign)}")
    return exemplars


def load_library_file(path: Path | str) -> list[Exemplar]:
    """Read one library file; raises AssetError when it is absent or damaged."""
    path = Path(path)
    if not path.is_file():
        raise AssetError(
            f"exemplar library {path} does not exist; build it with "
            f"`python -m hoi.exemplars.build {path.stem} --out {path.parent}`"
        )
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        return _exemplars_of(arrays)
    except (ValueError, KeyError, TypeError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise AssetError(f"exemplar library {path} is damaged: {error}; build it again") from error


def _exemplars_of(arrays: dict[str, np.ndarray]) -> list[Exemplar]:
    meta = json.loads(arrays["meta"].tobytes().decode())
    if meta.get("format") != _FORMAT:
        raise ValueError(f"format is {meta.get('format')!r}, expected {_FORMAT!r}")
    records = meta["exemplars"]
    vertex_counts, face_counts = arrays["vertex_counts"], arrays["face_counts"]
    expected = (len(records), int(vertex_counts.sum()), int(face_counts.sum()))
    have = (len(vertex_counts), len(arrays["vertices"]), len(arrays["faces"]))
    if expected != have or len(arrays["face_parts"]) != len(arrays["faces"]):
        raise ValueError(f"counts {expected} do not fit the arrays {have}")
    vertices = np.split(arrays["vertices"], np.cumsum(vertex_counts)[:-1])
    faces = np.split(arrays["faces"], np.cumsum(face_counts)[:-1])
    parts = np.split(arrays["face_parts"], np.cumsum(face_counts)[:-1])
    return [
        Exemplar(vertices=v, faces=f, face_parts=p, **record)
        for record, v, f, p in zip(records, vertices, faces, parts, strict=True)
    ]


def _inconsistency(e: Exemplar) -> str | None:
    """What is wrong with the arrays of an exemplar, or None."""
    if e.vertices.ndim != 2 or e.vertices.shape[1] != 3 or len(e.vertices) < 4:
        return f"vertices have shape {e.vertices.shape}, expected (V, 3)"
    if not np.isfinite(e.vertices).all():
        return "vertices hold NaN or infinity"
    if e.faces.ndim != 2 or e.faces.shape[1] != 3 or len(e.faces) < 4:
        return f"faces have shape {e.faces.shape}, expected (F, 3)"
    if e.faces.min() < 0 or e.faces.max() >= len(e.vertices):
        return f"faces refer to vertices outside 0..{len(e.vertices) - 1}"
    if e.face_parts.shape != (len(e.faces),):
        return f"face_parts have shape {e.face_parts.shape}, expected ({len(e.faces)},)"
    if not e.part_names or e.face_parts.min() < 0 or e.face_parts.max() >= len(e.part_names):
        return f"face_parts refer to parts outside the {len(e.part_names)} names"
    centre = (e.vertices.min(axis=0) + e.vertices.max(axis=0)) / 2
    if np.abs(centre).max() > 1e-3:
        return f"the bounding box is centred on {centre.round(4).tolist()}, expected the origin"
    return None


def _npz_bytes(arrays: dict[str, np.ndarray]) -> bytes:
    """An .npz archive whose bytes depend on the arrays alone."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            entry = io.BytesIO()
            np.lib.format.write_array(entry, array, allow_pickle=False)
            info = zipfile.ZipInfo(name + ".npy", _TIMESTAMP)
            info.compress_type = zipfile.ZIP_LZMA
            archive.writestr(info, entry.getvalue())
    return buffer.getvalue()
