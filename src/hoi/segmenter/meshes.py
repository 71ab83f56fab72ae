"""Textured furniture, things and people: read from the packs once, kept one file a mesh.

Only packs under CC0 and CC BY are read. The ground-truth objects of the embedded data set are left
out, so that nothing it shows was ever learned from; a share of the rest, chosen by name, is kept
for validation.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import posixpath
import re
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from hoi.errors import AssetError
from hoi.exemplars.furniture import furniture_models
from hoi.exemplars.sweethome import FurniturePack

PACKS = {
    "BlendSwap-CC-0": "CC0 1.0",
    "BlendSwap-CC-BY": "CC BY 3.0",
    "KatorLegaz": "CC BY 3.0 US",
    "Reallusion": "CC BY 3.0 US",
    "Scopia": "CC BY 3.0",
}
DEBIAN_PACKAGE = "sweethome3d-furniture"
_PEOPLE = "Reallusion"
_MAX_FACES = 26_000
_TEXTURE_SIDE = 256  # pixels that textures are reduced to
_OPAQUE = 0.35  # glass and leaves' cards under this opacity are dropped
_LEFT_OUT = ("Doors and windows", "Staircases")
_INDEX = "index.json"


@dataclass(frozen=True, eq=False)
class TexturedMesh:
    """One mesh: metres, y up, its lowest point at y = 0, centred in x and z.

    Args:
        name: pack and number.
        title: the catalogue's.
        person: whether it shows one.
        vertices: (V, 3); faces: (F, 3).
        uv: (F, 3, 2) texture coordinates of corners; `mapped` (F,) where there are any.
        face_materials: (F,) index into colours, glosses and texture_of.
        colours: (M, 3) linear reflectance; glosses: (M,); texture_of: (M,) index, -1 for none.
        textures: (H, W, 3) uint8 RGB each.
    """

    name: str
    title: str
    person: bool
    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    mapped: np.ndarray
    face_materials: np.ndarray
    colours: np.ndarray
    glosses: np.ndarray
    texture_of: np.ndarray
    textures: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class MeshEntry:
    """What the index knows of a mesh; `size` is width, height, depth in metres."""

    name: str
    title: str
    category: str
    person: bool
    held_out: bool
    size: tuple[float, float, float]


class MeshStore:
    """The meshes in a folder written by :func:`build_store`; raises AssetError if there is none."""

    def __init__(self, folder: Path | str):
        self.folder = Path(folder)
        try:
            rows = json.loads((self.folder / _INDEX).read_text())["meshes"]
        except (OSError, ValueError, KeyError) as error:
            raise AssetError(f"{self.folder} holds no meshes: {error}") from error
        self.entries = [MeshEntry(**{**row, "size": tuple(row["size"])}) for row in rows]

    def split(self, held_out: bool) -> list[MeshEntry]:
        """The meshes of training, or those held out from it."""
        return [entry for entry in self.entries if entry.held_out == held_out]

    def load(self, entry: MeshEntry) -> TexturedMesh:
        with np.load(self.folder / f"{entry.name}.npz", allow_pickle=False) as file:
            data = {key: file[key] for key in file.files}
        count = sum(key.startswith("picture") for key in data)
        textures = tuple(data.pop(f"picture{index}") for index in range(count))
        return TexturedMesh(entry.name, entry.title, entry.person, textures=textures, **data)


def fetch_packs(folder: Path) -> Path:
    """Download Debian's package with apt, unpack its packs into `folder`, and return that.

    Nothing is installed. Raises AssetError, saying what to do instead, where there is no apt.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if all((folder / f"{pack}.sh3f").is_file() for pack in PACKS):
        return folder
    advice = (
        f"download {DEBIAN_PACKAGE}_1.8-1_all.deb from a Debian mirror, put it into {folder} and "
        "run this again; or set segmenter.packs to a folder with the .sh3f files"
    )
    archives = sorted(folder.glob(f"{DEBIAN_PACKAGE}_*.deb"))
    if not archives:
        if shutil.which("apt-get") is None:
            raise AssetError(f"there is no apt-get here: {advice}")
        done = subprocess.run(
            ["apt-get", "download", DEBIAN_PACKAGE],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        archives = sorted(folder.glob(f"{DEBIAN_PACKAGE}_*.deb"))
        if done.returncode or not archives:
            raise AssetError(f"apt-get download {DEBIAN_PACKAGE}: {done.stderr.strip()}\n{advice}")
    _unpack(archives[-1], folder)
    return folder


def _unpack(archive: Path, folder: Path) -> None:
    """Write the packs inside a Debian package into `folder`; nothing else is taken from it."""
    wanted = {f"{pack}.sh3f" for pack in PACKS}
    with tarfile.open(fileobj=_data_of(archive)) as stream:
        for member in stream:
            name = posixpath.basename(member.name)
            reader = stream.extractfile(member) if name in wanted and member.isfile() else None
            if reader is not None:
                partial = folder / (name + ".partial")
                with partial.open("wb") as target:
                    shutil.copyfileobj(reader, target)
                partial.replace(folder / name)
                wanted.discard(name)
    if wanted:
        raise AssetError(f"{archive} lacks {', '.join(sorted(wanted))}")


def _data_of(archive: Path) -> io.BytesIO:
    """The data archive inside a .deb, which is an `ar` file."""
    content = archive.read_bytes()
    if not content.startswith(b"!<arch>\n"):
        raise AssetError(f"{archive} is no Debian package")
    offset = 8
    while offset + 60 <= len(content):
        name = content[offset : offset + 16].decode("ascii", "replace").strip().rstrip("/")
        size = int(content[offset + 48 : offset + 58])
        if name.startswith("data.tar"):
            return io.BytesIO(content[offset + 60 : offset + 60 + size])
        offset += 60 + size + size % 2
    raise AssetError(f"{archive} holds no data.tar")


def build_store(packs_dir: Path, out_dir: Path, held_out_share: float, limit: int = 0) -> int:
    """Convert every usable mesh of the packs; returns how many there are.

    Args:
        packs_dir: folder with the .sh3f packs.
        held_out_share: share of the meshes kept for validation, chosen by a hash of their name.
        limit: at most so many a pack, 0 for all (a quick look).
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    forbidden = {(model.pack, model.index) for model in _ground_truth()}
    rows = []
    for pack_name in PACKS:
        pack = FurniturePack(packs_dir / f"{pack_name}.sh3f")
        found = 0
        for index in pack.indices():
            if (pack_name, index) in forbidden or pack.value("category", index) in _LEFT_OUT:
                continue
            mesh = read_mesh(pack, pack_name, index)
            if mesh is None:
                continue
            _save(mesh, out_dir)
            entry = MeshEntry(
                mesh.name,
                mesh.title,
                pack.value("category", index),
                mesh.person,
                _held_out(mesh.name, held_out_share),
                tuple(np.round(np.ptp(mesh.vertices, axis=0), 3).tolist()),
            )
            rows.append(vars(entry))
            found += 1
            if limit and found >= limit:
                break
    document = {"licences": PACKS, "meshes": rows}
    (out_dir / _INDEX).write_text(json.dumps(document, indent=1) + "\n")
    return len(rows)


def _ground_truth():
    return [model for model in furniture_models() if model.role == "ground_truth"]


def _held_out(name: str, share: float) -> bool:
    return int(hashlib.sha256(name.encode()).hexdigest()[:8], 16) / 2**32 < share


def _save(mesh: TexturedMesh, folder: Path) -> None:
    arrays = {key: value for key, value in vars(mesh).items() if isinstance(value, np.ndarray)}
    arrays |= {f"picture{index}": picture for index, picture in enumerate(mesh.textures)}
    with tempfile.NamedTemporaryFile(dir=folder, suffix=".partial", delete=False) as partial:
        np.savez(partial, **arrays)  # type: ignore[arg-type]  # names are ours
    Path(partial.name).replace(folder / f"{mesh.name}.npz")


def read_mesh(pack: FurniturePack, pack_name: str, index: int) -> TexturedMesh | None:
    """One mesh of a pack with its materials; None for one that cannot be used."""
    try:
        entry = pack.entry(index)
    except AssetError:
        return None
    data = pack.file(entry.model)
    if data is None or not entry.model.lower().endswith(".obj"):
        return None
    try:
        shape = _parse_obj(data.decode("latin-1"), pack, posixpath.dirname(entry.model))
    except (ValueError, IndexError):
        return None
    if not 4 < len(shape.faces) < _MAX_FACES:
        return None
    library = shape.materials
    opaque = np.array([material.opacity >= _OPAQUE for material in library])
    keep = opaque[shape.face_materials]
    if keep.sum() < 4:
        return None
    used, faces = np.unique(shape.faces[keep], return_inverse=True)
    points = shape.vertices[used] @ entry.rotation.T
    low, high = points.min(0), points.max(0)
    points = (points - (low + high) / 2) / np.maximum(high - low, 1e-9) * entry.size
    points[:, 1] -= points[:, 1].min()
    if not np.isfinite(points).all():
        return None
    corners = shape.texture_faces[keep]
    uv = np.vstack([shape.texture_points, np.zeros((1, 2))])[corners]
    names: dict[str, int] = {}
    pictures = []
    for material in library:
        if material.texture and material.texture not in names:
            picture = _picture(pack.file(material.texture))
            names[material.texture] = -1 if picture is None else len(pictures)
            pictures += [] if picture is None else [picture]
    return TexturedMesh(
        name=f"{pack_name}_{index}",
        title=entry.title,
        person=pack_name == _PEOPLE,
        vertices=points.astype(np.float32),
        faces=faces.reshape(-1, 3).astype(np.int32),
        uv=uv.astype(np.float32),
        mapped=np.asarray((corners >= 0).all(1)),
        face_materials=shape.face_materials[keep].astype(np.int32),
        colours=np.array([np.power(m.colour, 2.2) for m in library], np.float32),
        glosses=np.array([m.gloss for m in library], np.float32),
        texture_of=np.array([names.get(m.texture, -1) for m in library], np.int32),
        textures=tuple(pictures),
    )


@dataclass
class _ObjMaterial:
    colour: tuple[float, ...] = (0.75, 0.75, 0.75)
    gloss: float = 0.0
    opacity: float = 1.0
    texture: str = ""


@dataclass(frozen=True)
class _Obj:
    vertices: np.ndarray
    texture_points: np.ndarray
    faces: np.ndarray
    texture_faces: np.ndarray  # -1 where a corner has none
    face_materials: np.ndarray
    materials: list[_ObjMaterial]


def _parse_obj(text: str, pack: FurniturePack, folder: str) -> _Obj:
    """An OBJ with its materials; polygons become fans. Raises ValueError for a damaged one."""
    vertices: list[list[float]] = []
    points: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    texture_faces: list[tuple[int, int, int]] = []
    face_materials: list[int] = []
    known: dict[str, _ObjMaterial] = {}
    materials = [_ObjMaterial()]
    numbers: dict[str, int] = {}
    current = 0
    for line in text.splitlines():
        head, _, rest = line.partition(" ")
        if head == "v":
            vertices.append([float(x) for x in rest.split()[:3]])
        elif head == "vt":
            points.append([float(x) for x in rest.split()[:2]])
        elif head == "mtllib":
            known |= _parse_materials(pack, posixpath.join(folder, rest.strip()), folder)
        elif head == "usemtl":
            name = rest.strip()
            if name not in numbers:
                numbers[name] = len(materials)
                materials.append(known.get(name, _ObjMaterial()))
            current = numbers[name]
        elif head == "f":
            corners = [_corner(token, len(vertices), len(points)) for token in rest.split()]
            for second, third in itertools.pairwise(corners[1:]):
                fan = (corners[0], second, third)
                faces.append((fan[0][0], fan[1][0], fan[2][0]))
                texture_faces.append((fan[0][1], fan[1][1], fan[2][1]))
                face_materials.append(current)
    if not faces:
        raise ValueError("no faces")
    result = _Obj(
        np.array(vertices, float),
        np.array(points, float).reshape(-1, 2),
        np.array(faces),
        np.array(texture_faces),
        np.array(face_materials),
        materials,
    )
    if result.faces.min() < 0 or result.faces.max() >= len(vertices):
        raise ValueError("a face refers to a vertex that is not there")
    if result.texture_faces.max() >= len(points):
        raise ValueError("a face refers to a texture point that is not there")
    return result


def _corner(token: str, vertices: int, points: int) -> tuple[int, int]:
    """Vertex and texture index of ``v``, ``v/t`` or ``v/t/n``."""
    parts = token.split("/")
    vertex = int(parts[0])
    texture = int(parts[1]) if len(parts) > 1 and parts[1] else 0
    vertex = vertex - 1 if vertex > 0 else vertices + vertex
    if texture == 0:
        return vertex, -1
    return vertex, texture - 1 if texture > 0 else points + texture


def _parse_materials(pack: FurniturePack, path: str, folder: str) -> dict[str, _ObjMaterial]:
    data = pack.file(path)
    found: dict[str, _ObjMaterial] = {}
    current = _ObjMaterial()
    for key, rest in _statements("" if data is None else data.decode("latin-1")):
        if key == "newmtl":
            current = found[rest] = _ObjMaterial()
        elif key == "Kd":
            numbers = _numbers(rest)
            current.colour = tuple(numbers[:3]) if len(numbers) >= 3 else current.colour
        elif key == "Ks":
            current.gloss = float(np.mean(_numbers(rest) or [0.0]))
        elif key == "d":
            current.opacity = (_numbers(rest) or [1.0])[-1]
        elif key == "map_Kd":
            current.texture = posixpath.normpath(posixpath.join(folder, rest))
    return found


def _statements(text: str) -> Iterator[tuple[str, str]]:
    for line in text.splitlines():
        match = re.match(r"\s*(\w+)\s+(.*?)\s*$", line)
        if match:
            yield match[1], match[2]


def _numbers(text: str) -> list[float]:
    try:
        return [min(max(float(x), 0.0), 1.0) for x in text.split()]
    except ValueError:
        return []


def _picture(data: bytes | None) -> np.ndarray | None:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    if picture is None:
        return None
    scale = _TEXTURE_SIDE / max(picture.shape[:2])
    if scale < 1:
        picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(picture[..., ::-1])
