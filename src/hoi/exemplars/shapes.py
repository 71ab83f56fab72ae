"""Candidates from whole folders of shapes, PartNet and ShapeNet: thousands, one at a time.

Of every shape only its signed distances are kept, in a cache folder, so that a run that was
interrupted goes on where it stopped; only the chosen shapes are re-meshed. A shape that cannot be
read is reported and left out.
"""

from __future__ import annotations

import io
import multiprocessing
import os
import sys
import time
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from hoi.digest import json_digest
from hoi.errors import AssetError, ConfigError
from hoi.exemplars import partnet
from hoi.exemplars import shapenet_layout as shapenet
from hoi.exemplars.config import ExemplarsConfig
from hoi.exemplars.labelling import label_faces
from hoi.exemplars.library import Exemplar
from hoi.exemplars.own_meshes import about_y
from hoi.exemplars.remesh import remesh
from hoi.exemplars.selection import soup_signed_distances, turned
from hoi.exemplars.shape_index import DEFAULT_CACHE, categories_of, shape_index

_VERSION = 1  # of the distances in the cache
_REPORT_SECONDS = 5.0
_LICENCE = {
    "partnet": "PartNet / ShapeNet terms (non-commercial research); not for redistribution",
    "shapenet": "ShapeNet terms (non-commercial research); not for redistribution",
}
#: Parts at the back and at the front of an object: they tell which way a shape faces.
_BACK_FRONT = {"chair": ("chair_back", "chair_seat"), "laptop": ("screen_side", "base_side")}
#: Metres that unit-sized shapes are scaled to: the extent (True: the height) a category has.
#: Only a start, the joint stage scales the object to its size prior.
_SIZES = {
    "chair": (True, 0.9), "stool": (True, 0.5), "couch": (True, 0.85), "table": (True, 0.75),
    "desk": (True, 0.75), "trashcan": (True, 0.6), "cabinet": (True, 1.0), "bed": (False, 2.0),
    "backpack": (False, 0.5), "suitcase": (False, 0.7), "handbag": (False, 0.35),
    "keyboard": (False, 0.45), "laptop": (False, 0.34), "display": (False, 0.55),
    "mug": (False, 0.12), "cup": (False, 0.12), "bottle": (False, 0.28), "bowl": (False, 0.16),
    "lamp": (False, 0.5), "knife": (False, 0.25), "scissors": (False, 0.2), "hat": (False, 0.3),
    "clock": (False, 0.3), "vase": (False, 0.3), "door": (True, 2.0), "microwave": (False, 0.5),
    "refrigerator": (True, 1.75), "dishwasher": (True, 0.85), "earphone": (False, 0.2),
    "faucet": (False, 0.3), "skateboard": (False, 0.8),
}  # fmt: skip
_OTHER_SIZE = (False, 0.5)


@dataclass(frozen=True)
class ShapeRef:
    """One shape on disk: `source` is partnet or shapenet, `path` its folder or mesh file."""

    source: str
    name: str
    path: Path


@dataclass(frozen=True)
class Shape:
    """A readable shape: its signed distances (grid^3,) float16 in the file's frame.

    `facing` is the angle about y, in degrees, from its front to +z as its parts tell, or NaN.
    """

    ref: ShapeRef
    distances: np.ndarray
    facing: float


def list_shapes(config: ExemplarsConfig, noun: str, cache: Path = DEFAULT_CACHE) -> list[ShapeRef]:
    """The shapes of a category in the configured folders, sorted by name.

    Raises ConfigError when a configured folder is not there or is none of the kind.
    """
    found = []
    if config.partnet:
        root, wanted = Path(config.partnet).expanduser(), categories_of(noun)
        for name, category in shape_index(root, cache).items():
            if category in wanted:
                found.append(ShapeRef("partnet", f"partnet_{name}", root / name))
    if config.shapenet:
        root = Path(config.shapenet).expanduser()
        if not root.is_dir():
            raise ConfigError(f"exemplars.shapenet: there is no folder {root}")
        for file in shapenet.list_shapes(root, noun):
            found.append(ShapeRef("shapenet", f"shapenet_{shapenet.model_name(file)}", file))
    return found


def read_shapes(
    refs: Sequence[ShapeRef],
    config: ExemplarsConfig,
    noun: str,
    cache: Path = DEFAULT_CACHE,
    workers: int = 1,
) -> list[Shape]:
    """The distances of all readable shapes that are of the category, in the order of `refs`.

    Progress and the shapes that are left out are reported on standard error. The result does not
    depend on `workers` (processes) nor on what the cache knows.
    """
    measure = partial(measure_shape, noun=noun, grid=config.grid, cache=Path(cache))
    shapes: list[Shape] = []
    left_out = others = 0
    report = _progress(f"{noun} shapes", len(refs))
    for done, outcome in enumerate(_mapped(measure, refs, workers), 1):
        if isinstance(outcome, Shape):
            shapes.append(outcome)
        elif outcome:
            left_out += 1
            print(f"left out: {outcome}", file=sys.stderr)
        else:
            others += 1
        report(done, f"{left_out} left out, {others} of another kind")
    return shapes


def measure_shape(ref: ShapeRef, noun: str, grid: int, cache: Path) -> Shape | str | None:
    """A shape's distances, from the cache or measured now.

    Returns None for a shape of another noun, a sentence for one that cannot be used.
    """
    try:
        entry = cache / f"{_key(ref, noun, grid)}.npz"
        known = _load(entry)
        if known is None:
            known = _measure(ref, noun, grid)
            _store(entry, known)
    except AssetError as error:
        return str(error)
    except OSError as error:
        return f"{ref.path}: {error}"
    if not len(known["distances"]):
        return None
    return Shape(ref, known["distances"], float(known["facing"]))


def common_yaw(shapes: Iterable[Shape]) -> float | None:
    """The quarter turn about y that most shapes need to face +z; None when none can tell."""
    angles = np.array([shape.facing for shape in shapes if np.isfinite(shape.facing)])
    if not len(angles):
        return None
    votes = np.bincount(np.round(angles / 90).astype(int) % 4, minlength=4)
    return float(90 * votes.argmax())


def yaw_of(config: ExemplarsConfig, shapes: Sequence[Shape]) -> float:
    """Degrees about y that bring shapes of one source to face +z.

    `auto` asks the shapes' parts and, where they say nothing, takes the source's convention.
    """
    first = shapes[0].ref
    chosen = (
        config.partnet_yaw_degrees if first.source == "partnet" else config.shapenet_yaw_degrees
    )
    if chosen != "auto":
        return float(chosen)
    if first.source == "shapenet":
        return shapenet.default_yaw(first.path)
    return common_yaw(shapes) or 0.0


def features(shapes: Sequence[Shape], yaw: float) -> np.ndarray:
    """(N, grid^3) float32 signed distances in the canonical frame.

    Only quarter turns can be made on the grid; for others the nearest one stands in, which only
    matters for how shapes of different sources compare.
    """
    stacked = np.stack([shape.distances for shape in shapes]).astype(np.float32)
    return turned(stacked, round(yaw / 90))


def load_shape(config: ExemplarsConfig, ref: ShapeRef, noun: str, yaw: float) -> Exemplar:
    """A shape re-meshed, in metres, in the canonical frame; raises AssetError naming the file."""
    soup = _read(ref, noun)
    if soup is None:
        raise AssetError(f"{ref.path}: is no {noun} any more; it changed since it was listed")
    points = _scaled(soup.vertices @ about_y(yaw).T, soup.faces, noun)
    try:
        vertices, faces, nearest = remesh(points, soup.faces, config.remesh, config.vertices)
    except AssetError as error:
        raise AssetError(f"{ref.path}: {error}") from error
    vertices -= (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    if soup.part_names:
        used, parts = np.unique(soup.face_parts[nearest], return_inverse=True)
        names = tuple(soup.part_names[i] for i in used)
    else:
        names, parts = label_faces(noun, vertices, faces)
    return Exemplar(ref.name, noun, vertices, faces, names, parts, ref.source, _LICENCE[ref.source])


# ---------------------------------------------------------------------------------- internals


def _read(ref: ShapeRef, noun: str) -> partnet.LabelledSoup | None:
    if ref.source == "partnet":
        return partnet.read_shape(ref.path, noun)
    vertices, faces = partnet.read_obj(ref.path)
    return partnet.LabelledSoup(vertices, faces, (), np.zeros(len(faces), np.int64))


def _measure(ref: ShapeRef, noun: str, grid: int) -> dict[str, np.ndarray]:
    soup = _read(ref, noun)
    if soup is None:
        return {"distances": np.zeros(0, np.float16), "facing": np.array(np.nan)}
    extent = np.ptp(soup.vertices[np.unique(soup.faces)], axis=0)
    if not (extent > 1e-6).any():
        raise AssetError(f"{ref.path}: the mesh has no extent")
    used, faces = np.unique(soup.faces, return_inverse=True)
    distances = soup_signed_distances(soup.vertices[used], faces.reshape(-1, 3), grid)
    return {"distances": distances.astype(np.float16), "facing": np.array(_facing(soup, noun))}


def _facing(soup: partnet.LabelledSoup, noun: str) -> float:
    """Degrees about y from the front of a shape to +z: the front is where the back is not."""
    back, front = _BACK_FRONT.get(noun, ("", ""))
    if back not in soup.part_names or front not in soup.part_names:
        return float("nan")
    triangles = soup.vertices[soup.faces]
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area, centre = np.linalg.norm(cross, axis=1), triangles.mean(axis=1)

    def middle(part: str) -> np.ndarray:
        of_part = soup.face_parts == soup.part_names.index(part)
        return np.average(centre[of_part], axis=0, weights=area[of_part] + 1e-12)

    ahead = middle(front) - middle(back)
    if np.hypot(ahead[0], ahead[2]) < 1e-3:
        return float("nan")
    return float(np.degrees(np.arctan2(-ahead[0], ahead[2])))


def _scaled(vertices: np.ndarray, faces: np.ndarray, noun: str) -> np.ndarray:
    """Unit-sized vertices in metres, by the size its category usually has."""
    by_height, metres = _SIZES.get(noun, _OTHER_SIZE)
    extent = np.ptp(vertices[np.unique(faces)], axis=0)
    return vertices * (metres / max(float(extent[1] if by_height else extent.max()), 1e-9))


def _key(ref: ShapeRef, noun: str, grid: int) -> str:
    """Names the distances of one state of a shape's files, without reading them."""
    files = partnet.input_files(ref.path) if ref.source == "partnet" else [ref.path]
    stats = [(str(f.resolve()), *_stamp(f)) for f in files]
    digest = json_digest([_VERSION, ref.source, noun, grid, stats])
    return f"{digest[:2]}/{digest[2:34]}"


def _stamp(file: Path) -> tuple[int, int]:
    stat = file.stat()
    return stat.st_size, stat.st_mtime_ns


def _load(entry: Path) -> dict[str, np.ndarray] | None:
    """A cache entry, or None when it is not there or damaged: then it is measured again."""
    try:
        with np.load(entry, allow_pickle=False) as stored:
            return {"distances": stored["distances"], "facing": stored["facing"]}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _store(entry: Path, known: dict[str, np.ndarray]) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, distances=known["distances"], facing=known["facing"])
    entry.parent.mkdir(parents=True, exist_ok=True)
    partial_file = entry.with_suffix(f".{os.getpid()}")
    partial_file.write_bytes(buffer.getvalue())
    partial_file.replace(entry)


def _mapped(
    measure: Callable[[ShapeRef], Shape | str | None], refs: Sequence[ShapeRef], workers: int
) -> Iterator[Shape | str | None]:
    if workers <= 1:
        yield from map(measure, refs)
        return
    # not forked: the ray casting library keeps threads of its own
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        yield from pool.map(measure, refs, chunksize=8)


def _progress(what: str, total: int) -> Callable[[int, str], None]:
    """A line every few seconds: how far, how fast, how long still."""
    started = last = time.monotonic()

    def report(done: int, remark: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < _REPORT_SECONDS and done < total:
            return
        last = now
        left = (now - started) / done * (total - done)
        rate = done / max(now - started, 1e-9)
        print(
            f"{what}: {done}/{total} ({rate:.1f} a second, {left / 60:.1f} min left; {remark})",
            file=sys.stderr,
            flush=True,
        )

    return report
