"""Reader of Sweet Home 3D furniture packs (.sh3f): a catalogue and OBJ models in one zip."""

from __future__ import annotations

import itertools
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hoi.errors import AssetError

_CATALOGUE = "PluginFurnitureCatalog.properties"


@dataclass(frozen=True)
class CatalogueEntry:
    """One model: `size` is width, height, depth in metres; `rotation` the model's own turn."""

    index: int
    title: str
    creator: str
    model: str
    size: np.ndarray
    rotation: np.ndarray


class FurniturePack:
    """One opened pack; raises AssetError when the file is no pack."""

    def __init__(self, path: Path | str):
        try:
            self._archive = zipfile.ZipFile(path)
            text = self._archive.read(_CATALOGUE).decode("latin-1")
        except (OSError, KeyError, zipfile.BadZipFile) as error:
            raise AssetError(f"{path} is not a Sweet Home 3D furniture pack: {error}") from error
        self.path = Path(path)
        self._properties = _parse_properties(text)

    def entry(self, index: int) -> CatalogueEntry:
        """The catalogue entry number `index`; raises AssetError when there is none."""

        def value(key: str, default: str | None = None) -> str:
            found = self._properties.get(f"{key}#{index}", default)
            if found is None:
                raise AssetError(f"{self.path}: entry {index} has no {key}")
            return found

        size = np.array([float(value(k)) for k in ("width", "height", "depth")]) / 100
        turn = value("modelRotation", "1 0 0 0 1 0 0 0 1")
        return CatalogueEntry(
            index,
            value("name"),
            value("creator", ""),
            value("model").lstrip("/"),
            size,
            np.array(turn.split(), float).reshape(3, 3),
        )

    def indices(self) -> list[int]:
        """Numbers of all entries."""
        numbers = [key.partition("#") for key in self._properties]
        return sorted(int(number) for head, _, number in numbers if head == "model")

    def value(self, key: str, index: int) -> str:
        """Any property of an entry; empty when it has none of that name."""
        return self._properties.get(f"{key}#{index}", "")

    def file(self, name: str) -> bytes | None:
        """A file of the pack; None when there is none of that name."""
        try:
            return self._archive.read(name)
        except KeyError:
            return None

    def mesh(self, entry: CatalogueEntry) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """vertices (V, 3) m, faces (F, 3) and group name of each face, in the canonical frame."""
        text = self._archive.read(entry.model).decode("latin-1")
        vertices, faces, groups = parse_obj(text)
        vertices = vertices @ entry.rotation.T
        used = vertices[np.unique(faces)]
        low, high = used.min(axis=0), used.max(axis=0)
        centred = (vertices - (low + high) / 2) / np.maximum(high - low, 1e-9)
        return centred * entry.size, faces, groups


def parse_obj(text: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """vertices (V, 3), triangles (F, 3) and the `g`/`o` name of each, of an OBJ file.

    Polygons become fans; texture and normal indices are ignored; indices may be negative.
    Raises ValueError when the text has no faces or damaged ones.
    """
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    groups: list[str] = []
    group = ""
    for line in text.splitlines():
        head, _, rest = line.partition(" ")
        if head == "v":
            vertices.append([float(x) for x in rest.split()[:3]])
        elif head in ("g", "o"):
            group = rest.strip()
        elif head == "f":
            corners = [int(token.split("/")[0]) for token in rest.split()]
            ids = [c - 1 if c > 0 else len(vertices) + c for c in corners]
            fan = [(ids[0], b, c) for b, c in itertools.pairwise(ids[1:])]
            faces += fan
            groups += [group] * len(fan)
    if not faces:
        raise ValueError("no faces")
    points, triangles = np.array(vertices), np.array(faces, np.int64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError("a vertex has fewer than three coordinates")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise ValueError("a face refers to a vertex that is not there")
    return points, triangles, np.array(groups)


def _parse_properties(text: str) -> dict[str, str]:
    """key=value lines with \\uXXXX escapes."""
    properties = {}
    for line in text.splitlines():
        line = line.strip()
        if line and line[0] not in "#!" and "=" in line:
            key, _, value = line.partition("=")
            unescaped = re.sub(r"\\u([0-9a-fA-F]{4})", lambda m: chr(int(m[1], 16)), value.strip())
            properties[key.strip()] = unescaped
    return properties
