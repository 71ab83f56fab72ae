"""Reader of BEHAVE's tree: frames, ground truth and the raw files behind them.

The generated set :mod:`hoi.datasets.behave_mini` has the same layout and is read by this module.
Meshes are in metres in the frame of the colour camera of Kinect 1 (OpenCV axes).
"""

from __future__ import annotations

import io
import json
import math
import pickle
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from hoi.artifacts import Frame, GroundTruth
from hoi.datasets.behave_layout import (
    ACTION_GROUPS,
    TABLE_GROUPS,
    FrameRef,
    frame_folder,
    frame_ref,
    is_frame_folder,
    object_folder_names,
    parse_sequence,
    sequence_folder,
)
from hoi.errors import ConfigError, FrameFailure

__all__ = [
    "FrameRef",
    "frame_files",
    "frame_ref",
    "ground_truth_files",
    "list_frames",
    "read_frame",
    "read_ground_truth",
]

MASK_THRESHOLD = 127
#: fx, fy, cx, cy, width, height of the colour camera of Kinect 1 as calibrated by BEHAVE
KINECT1 = (979.784, 979.840, 1018.952, 779.486, 2048, 1536)
_BODY25_LENGTH = 75
_SMPLH_HANDS = (25, 40)  # middle knuckles, the nearest to SMPL's left_hand and right_hand


# ------------------------------------------------------------------------------------ listing


def list_frames(
    root: Path | str,
    category_group: str,
    split: str,
    kinect: int = 1,
    with_ground_truth: bool = True,
) -> list[FrameRef]:
    """Frames on disk of one table group and split, sorted.

    Args:
        root: the BEHAVE folder, holding ``split.json`` and ``sequences/``.
        category_group: chair, table, keyboard or backpack, see `TABLE_GROUPS`.
        split: a key of ``split.json``, e.g. ``test``.
        kinect: camera; frames without a colour image of it are listed all the same.
        with_ground_truth: only frames that have a person fit and an object fit, as in the test
            lists of later papers (BEHAVE has frames in which a fit failed).

    Raises ConfigError when the data set, group or split is not there.
    """
    del kinect  # every frame folder holds all its cameras
    objects = _objects_of(category_group)
    wanted = [s for s in _split(root, split) if parse_sequence(s)[2] in objects]
    refs = []
    for sequence in sorted(wanted):
        folder = sequence_folder(root, sequence)
        if parse_sequence(sequence)[3] not in ACTION_GROUPS[parse_sequence(sequence)[2]]:
            continue
        if not folder.is_dir():
            continue
        times = sorted(p.name for p in folder.iterdir() if is_frame_folder(p.name))
        refs += [frame_ref(sequence, time) for time in times]
    if with_ground_truth:
        refs = [r for r in refs if _fit(root, r, _PERSON) and _fit(root, r, _object_fits(r))]
    if not refs:
        raise ConfigError(
            f"{root}: no frames of group {category_group!r} in split {split!r}; "
            f"{len(wanted)} sequences are listed in split.json, none of them is in "
            f"{Path(root) / 'sequences'} with fits"
        )
    return refs


def _objects_of(category_group: str) -> tuple[str, ...]:
    if category_group not in TABLE_GROUPS:
        raise ConfigError(
            f"unknown category group {category_group!r}; known: {', '.join(TABLE_GROUPS)}"
        )
    return TABLE_GROUPS[category_group]


def _split(root: Path | str, split: str) -> list[str]:
    path = Path(root) / "split.json"
    try:
        splits = json.loads(path.read_text(encoding="utf-8"))
        names = splits[split]
        for name in names:
            parse_sequence(name)
    except FileNotFoundError as error:
        raise ConfigError(f"{path} does not exist; is {root} a BEHAVE folder?") from error
    except KeyError as error:
        raise ConfigError(f"{path} has no split {split!r}; it has {', '.join(splits)}") from error
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{path}: not a BEHAVE split file: {error}") from error
    return list(names)


# --------------------------------------------------------------------------------- raw files


def frame_files(root: Path | str, ref: FrameRef, kinect: int = 1) -> list[Path]:
    """The existing files that :func:`read_frame` depends on, sorted, for content hashing."""
    folder = frame_folder(root, ref)
    found = [
        folder / f"k{kinect}.color.jpg",
        _person_mask(folder, kinect),
        _object_mask(folder, kinect),
        folder / f"k{kinect}.color.json",
        _calibration(root, kinect),
    ]
    return sorted(path for path in found if path is not None and path.is_file())


def ground_truth_files(root: Path | str, ref: FrameRef, kinect: int = 1) -> list[Path]:
    """The existing files that :func:`read_ground_truth` depends on, sorted."""
    folder = frame_folder(root, ref)
    person = folder / "person" / "fit02"
    found = [
        _fit(root, ref, _PERSON),
        _fit(root, ref, _object_fits(ref)),
        person / "person_fit.json",
        person / "person_J.ply",
        _object_mask(folder, kinect),
        _mask(folder, f"k{kinect}.obj_rend_full"),
        _extrinsics(root, ref, kinect),
    ]
    fit = found[1]
    if fit is not None and fit.suffix == ".pkl":
        found.append(_template(root, ref.object_name))
    return sorted(path for path in found if path is not None and path.is_file())


_PERSON = ("person/fit02/person_fit",)


def _object_fits(ref: FrameRef) -> tuple[str, ...]:
    return tuple(f"{n}/fit01/{n}_fit" for n in object_folder_names(ref.object_name))


def _fit(root: Path | str, ref: FrameRef, stems: Sequence[str]) -> Path | None:
    """The fit of one frame, the mesh before the parameters, or None."""
    folder = frame_folder(root, ref)
    for stem in stems:
        for suffix in (".ply", ".pkl"):
            path = folder / f"{stem}{suffix}"
            if path.is_file():
                return path
    return None


def _mask(folder: Path, stem: str) -> Path | None:
    return next((p for s in (".png", ".jpg") if (p := folder / f"{stem}{s}").is_file()), None)


def _person_mask(folder: Path, kinect: int) -> Path | None:
    return _mask(folder, f"k{kinect}.person_mask")


def _object_mask(folder: Path, kinect: int) -> Path | None:
    rendered = _mask(folder, f"k{kinect}.obj_rend_mask")
    return rendered or _mask(folder, f"k{kinect}.obj_mask")


def _calibration(root: Path | str, kinect: int) -> Path:
    return Path(root) / "calibs" / "intrinsics" / str(int(kinect)) / "calibration.json"


def _extrinsics(root: Path | str, ref: FrameRef, kinect: int) -> Path | None:
    """Camera-to-world of a Kinect; world is Kinect 1, which therefore needs no file."""
    if kinect == 1:
        return None
    date = parse_sequence(ref.sequence)[0]
    return Path(root) / "calibs" / date / "config" / str(int(kinect)) / "config.json"


def _template(root: Path | str, object_name: str) -> Path | None:
    """The simplified scan that an object's pose parameters refer to."""
    folder = Path(root) / "objects" / object_name
    candidates = sorted(folder.glob("*_f[0-9]*.ply"))
    return candidates[0] if candidates else None


# ------------------------------------------------------------------------------------- frames


def read_frame(root: Path | str, ref: FrameRef, kinect: int = 1, dataset: str = "behave") -> Frame:
    """The photo, its camera, and the masks and keypoints that the data set ships.

    Masks and keypoints that are absent become None; all-zero keypoints stay zeros (BEHAVE writes
    them where OpenPose failed).

    Raises FrameFailure: image_missing, image_unreadable, calibration_unreadable, mask_unreadable,
    mask_size_mismatch, person_mask_empty, object_mask_empty, keypoints_unreadable.
    """
    folder = frame_folder(root, ref)
    image = read_image(folder / f"k{kinect}.color.jpg")
    height, width = image.shape[:2]
    intrinsics, source = _intrinsics(_calibration(root, kinect), kinect, width, height)
    person = _read_mask(_person_mask(folder, kinect), image.shape[:2], "person_mask_empty")
    thing = _read_mask(_object_mask(folder, kinect), image.shape[:2], "object_mask_empty")
    return Frame(
        frame_id=ref.frame_id,
        dataset=dataset,
        category=ref.category,
        object_name=ref.object_name,
        action=ref.action,
        source=f"{ref.sequence}/{ref.time}/k{kinect}.color.jpg",
        image=image,
        intrinsics=intrinsics,
        intrinsics_source=source,
        given_person_mask=person,
        given_object_mask=thing,
        given_keypoints=_read_keypoints(folder / f"k{kinect}.color.json"),
    )


def read_image(path: Path) -> np.ndarray:
    """(H, W, 3) uint8 RGB; raises FrameFailure image_missing or image_unreadable."""
    return np.asarray(open_image(path).convert("RGB"))


def open_image(path: Path) -> Image.Image:
    """A fully decoded picture; raises FrameFailure image_missing or image_unreadable."""
    if not path.is_file():
        raise FrameFailure("image_missing", f"{path.name} does not exist in {path.parent.name}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            image = Image.open(path)
            image.load()  # a truncated file fails here and not later
    except (OSError, ValueError, SyntaxError, EOFError, Warning) as error:
        raise FrameFailure("image_unreadable", f"{path.name}: {error}") from error
    except Image.DecompressionBombError as error:
        raise FrameFailure("image_unreadable", f"{path.name}: {error}") from error
    return image


def _read_mask(path: Path | None, shape: tuple[int, ...], when_empty: str) -> np.ndarray | None:
    if path is None:
        return None
    mask = read_mask(path, shape)
    if not mask.any():
        raise FrameFailure(when_empty, f"{path.name} marks no pixel")
    return mask


def read_mask(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """(H, W) bool of a grey mask picture.

    Raises FrameFailure mask_unreadable or mask_size_mismatch.
    """
    try:
        mask = np.asarray(open_image(path).convert("L")) > MASK_THRESHOLD
    except FrameFailure as failure:
        raise FrameFailure("mask_unreadable", failure.detail) from failure
    if mask.shape != tuple(shape):
        have, want = f"{mask.shape[1]}x{mask.shape[0]}", f"{shape[1]}x{shape[0]}"
        raise FrameFailure("mask_size_mismatch", f"{path.name} is {have}, the image {want}")
    return mask


def _intrinsics(path: Path, kinect: int, width: int, height: int) -> tuple[np.ndarray, str]:
    """K in pixels of the image as stored; lens distortion is small and ignored, as by all peers."""
    if path.is_file():
        try:
            color = json.loads(path.read_text(encoding="utf-8"))["color"]
            names = ("fx", "fy", "cx", "cy", "width", "height")
            values = [float(color[name]) for name in names]
        except (ValueError, KeyError, TypeError, OSError) as error:
            raise FrameFailure("calibration_unreadable", f"{path.name}: {error!r}") from error
        source = f"calibration of Kinect {kinect}"
    else:
        values = [float(v) for v in KINECT1]
        source = "calibration of BEHAVE's Kinect 1 (no calibration file)"
    fx, fy, cx, cy, calibrated_width, calibrated_height = values
    if not all(math.isfinite(v) for v in values) or min(fx, fy, values[4], values[5]) <= 0:
        raise FrameFailure("calibration_unreadable", f"{path.name}: {values}")
    sx, sy = width / calibrated_width, height / calibrated_height
    return np.array([[fx * sx, 0, cx * sx], [0, fy * sy, cy * sy], [0, 0, 1.0]]), source


def _read_keypoints(path: Path) -> np.ndarray | None:
    """(21, 3) in the order of KEYPOINTS from an OpenPose BODY_25 file, or None when absent."""
    from hoi.body.keypoints import FROM_BODY25

    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        flat = content.get("body_joints")
        if flat is None:  # a file as OpenPose itself writes it
            people = content["people"]
            flat = people[0]["pose_keypoints_2d"] if people else [0.0] * _BODY25_LENGTH
        joints = np.asarray(flat, np.float64)
        if joints.size != _BODY25_LENGTH or not np.isfinite(joints).all():
            raise ValueError(f"expected {_BODY25_LENGTH} finite numbers, found {joints.size}")
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OSError) as error:
        raise FrameFailure("keypoints_unreadable", f"{path.name}: {error!r}") from error
    return joints.reshape(25, 3)[np.asarray(FROM_BODY25)].astype(np.float32)


# ------------------------------------------------------------------------------- ground truth


def read_ground_truth(root: Path | str, ref: FrameRef, kinect: int = 1) -> GroundTruth:
    """The fitted meshes in the frame of camera `kinect`.

    `body_joints` come from ``person_J.ply`` or ``person_fit.json`` where they exist, else None.

    Raises FrameFailure: ground_truth_missing, ground_truth_unreadable, mask_size_mismatch.
    """
    person = _fit(root, ref, _PERSON)
    thing = _fit(root, ref, _object_fits(ref))
    if person is None or thing is None:
        absent = "person" if person is None else "object"
        raise FrameFailure("ground_truth_missing", f"{ref.frame_id} has no {absent} fit")
    if person.suffix == ".pkl":
        raise FrameFailure(
            "ground_truth_missing",
            f"{ref.frame_id} has person_fit.pkl but no person_fit.ply; parameters need SMPL-H",
        )
    body_vertices, body_faces = _read_mesh(person)
    if thing.suffix == ".ply":
        object_vertices, object_faces = _read_mesh(thing)
    else:
        object_vertices, object_faces = _placed_template(root, ref, thing)
    joints, model = _read_joints(person.parent, len(body_vertices))
    to_camera = _world_to_camera(_extrinsics(root, ref, kinect))
    return GroundTruth(
        frame_id=ref.frame_id,
        body_model=model,
        body_vertices=to_camera(body_vertices),
        body_faces=body_faces,
        body_joints=None if joints is None else to_camera(joints),
        object_vertices=to_camera(object_vertices),
        object_faces=object_faces,
        visible_fraction=_visible_fraction(frame_folder(root, ref), kinect),
    )


def _read_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    try:
        mesh: Any = trimesh.load(path, process=False, force="mesh")
        vertices = np.asarray(mesh.vertices, np.float32)
        faces = np.asarray(mesh.faces, np.int64)
    except Exception as error:  # the mesh loader raises whatever its parser met
        raise FrameFailure("ground_truth_unreadable", f"{path.name}: {error!r}") from error
    fits = len(faces) and faces.min() >= 0 and faces.max() < len(vertices)
    if not fits or not np.isfinite(vertices).all():
        raise FrameFailure("ground_truth_unreadable", f"{path.name} holds no mesh")
    return vertices, faces


def _placed_template(root: Path | str, ref: FrameRef, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The simplified scan, centred on the mean of its vertices, at the pose of `path`."""
    from scipy.spatial.transform import Rotation

    template = _template(root, ref.object_name)
    if template is None:
        raise FrameFailure(
            "ground_truth_missing",
            f"objects/{ref.object_name} has no simplified scan (*_fNNNN.ply)",
        )
    vertices, faces = _read_mesh(template)
    try:
        pose = _load_plain_pickle(path)
        rotation = Rotation.from_rotvec(np.asarray(pose["angle"], float).reshape(3)).as_matrix()
        translation = np.asarray(pose["trans"], float).reshape(3)
    except (pickle.UnpicklingError, KeyError, ValueError, TypeError, EOFError, OSError) as error:
        raise FrameFailure("ground_truth_unreadable", f"{path.name}: {error}") from error
    centred = vertices.astype(float) - vertices.astype(float).mean(axis=0)
    return (centred @ rotation.T + translation).astype(np.float32), faces


def _read_joints(folder: Path, vertex_count: int) -> tuple[np.ndarray | None, str]:
    """Joints (24, 3) or None, and the identity of the body topology."""
    described, joints_file = folder / "person_fit.json", folder / "person_J.ply"
    try:
        if described.is_file():
            content = json.loads(described.read_text(encoding="utf-8"))
            joints = np.asarray(content["joints"], np.float32)
            if joints.shape != (24, 3) or not np.isfinite(joints).all():
                raise ValueError(f"joints have shape {joints.shape}")
            return joints, str(content["body_model"])
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise FrameFailure("ground_truth_unreadable", f"{described.name}: {error!r}") from error
    model = "smplh" if vertex_count == 6890 else f"unknown-{vertex_count}"
    if not joints_file.is_file():
        return None, model
    import trimesh

    try:
        cloud: Any = trimesh.load(joints_file, process=False)
        joints = np.asarray(cloud.vertices, np.float32)
    except Exception as error:  # the mesh loader raises whatever its parser met
        raise FrameFailure("ground_truth_unreadable", f"{joints_file.name}: {error!r}") from error
    if len(joints) >= 52:  # SMPL-H: 22 body joints, then 15 a hand
        joints = joints[[*range(22), *_SMPLH_HANDS]]
    return (joints[:24] if len(joints) >= 24 else None), model


def _world_to_camera(path: Path | None):
    """Points of the world (Kinect 1) into another Kinect: the inverse of its stored pose."""
    if path is None:
        return lambda points: points
    try:
        pose = json.loads(path.read_text(encoding="utf-8"))
        rotation = np.asarray(pose["rotation"], float).reshape(3, 3)
        translation = np.asarray(pose["translation"], float).reshape(3)
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise FrameFailure("calibration_unreadable", f"{path}: {error!r}") from error
    return lambda points: ((points - translation) @ rotation).astype(np.float32)


def _visible_fraction(folder: Path, kinect: int) -> float | None:
    """Visible over full object silhouette, or None when the full mask was not downloaded."""
    visible, full = _object_mask(folder, kinect), _mask(folder, f"k{kinect}.obj_rend_full")
    if visible is None or full is None:
        return None
    try:
        with Image.open(full) as image:
            shape = (image.height, image.width)
        area = read_mask(full, shape).sum()
        return float(read_mask(visible, shape).sum() / area) if area else None
    except (FrameFailure, OSError):
        return None


# ------------------------------------------------------------------------------ safe unpickling

_PLAIN_GLOBALS = {
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("numpy.core.multiarray", "_reconstruct"),
    ("numpy.core.multiarray", "scalar"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"),
    ("numpy.core.numeric", "_frombuffer"),
    ("numpy._core.numeric", "_frombuffer"),
    ("_codecs", "encode"),
}


class _PlainUnpickler(pickle.Unpickler):
    """Unpickles numbers, strings, containers and plain numpy arrays; refuses all else."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _PLAIN_GLOBALS:
            raise pickle.UnpicklingError(f"refused to load {module}.{name}: not plain numpy data")
        return super().find_class(module, name)


def _load_plain_pickle(path: Path) -> Any:
    content = _PlainUnpickler(io.BytesIO(path.read_bytes()), encoding="latin1").load()
    if not isinstance(content, dict):
        raise pickle.UnpicklingError(f"holds {type(content).__name__}, expected a dict")
    return content
