"""BEHAVE's cameras: what a sequence says of itself, intrinsics and extrinsics of four Kinects.

Lens distortion is ignored: pictures are not undistorted and points are projected by a pinhole, as
in the later papers on this data set. The world is the frame of the colour camera of Kinect 1.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hoi.datasets.behave_layout import gender_of, parse_sequence, sequence_folder
from hoi.errors import FrameFailure

#: fx, fy, cx, cy, width, height of the colour cameras as calibrated by BEHAVE
KINECTS = {
    0: (976.212, 976.047, 1017.958, 787.313, 2048, 1536),
    1: (979.784, 979.840, 1018.952, 779.486, 2048, 1536),
    2: (974.899, 974.337, 1018.747, 786.176, 2048, 1536),
    3: (972.873, 972.790, 1022.0565, 770.397, 2048, 1536),
}
_NAMES = ("fx", "fy", "cx", "cy", "width", "height")


class SequenceInfo(NamedTuple):
    """What the reader needs of ``info.json``; its defaults where the file is absent."""

    gender: str
    poses: Path  # folder holding <kinect>/config.json
    intrinsics: Path  # folder holding <kinect>/calibration.json


def sequence_info(root: Path | str, sequence: str) -> SequenceInfo:
    """Read ``info.json`` of a sequence.

    Its paths are relative to the sequence. Raises FrameFailure sequence_info_unreadable, also for
    a path that leaves the data set.
    """
    root = Path(root)
    path = info_file(root, sequence)
    try:
        stamp = path.stat()
    except (OSError, ValueError):
        date, subject = parse_sequence(sequence)[:2]
        return SequenceInfo(gender_of(subject), _poses(root, date), _intrinsics_folder(root))
    return _info(root, sequence, (stamp.st_mtime_ns, stamp.st_size, stamp.st_ino))


@functools.lru_cache(maxsize=1024)  # every file of every frame of a sequence asks for it
def _info(root: Path, sequence: str, stamp: tuple[int, int, int]) -> SequenceInfo:
    path = info_file(root, sequence)
    date, subject = parse_sequence(sequence)[:2]
    content = _read_json(path, "sequence_info_unreadable")
    gender = content.get("gender") or gender_of(subject)
    if gender not in ("male", "female", "neutral"):
        raise FrameFailure(
            "sequence_info_unreadable", f"{sequence}/info.json, key 'gender': {gender!r}"
        )
    return SequenceInfo(
        gender,
        _inside(root, path, content, "config") or _poses(root, date),
        _inside(root, path, content, "intrinsic") or _intrinsics_folder(root),
    )


def info_file(root: Path | str, sequence: str) -> Path:
    """Where a sequence describes itself."""
    return sequence_folder(root, sequence) / "info.json"


def _poses(root: Path, date: str) -> Path:
    return root / "calibs" / date / "config"


def _intrinsics_folder(root: Path) -> Path:
    return root / "calibs" / "intrinsics"


def _inside(root: Path, path: Path, content: dict[str, Any], key: str) -> Path | None:
    """The folder that `key` names, if it exists; never one outside of the data set."""
    named = content.get(key)
    if named is None:
        return None
    where = f"{path.parent.name}/{path.name}, key {key!r}"
    if not isinstance(named, str) or "\0" in named:
        raise FrameFailure("sequence_info_unreadable", f"{where}: holds {named!r}, not a path")
    folder = path.parent / named
    if not folder.resolve().is_relative_to(root.resolve()):
        raise FrameFailure("sequence_info_unreadable", f"{where}: {named} leaves the data set")
    return folder if folder.is_dir() else None


def calibration_file(root: Path | str, sequence: str, kinect: int) -> Path:
    """The intrinsics of one Kinect."""
    return sequence_info(root, sequence).intrinsics / str(int(kinect)) / "calibration.json"


def extrinsics_file(root: Path | str, sequence: str, kinect: int) -> Path | None:
    """The pose of one Kinect; None for Kinect 1, which is the world."""
    if kinect == 1:
        return None
    return sequence_info(root, sequence).poses / str(int(kinect)) / "config.json"


def read_intrinsics(path: Path, kinect: int, width: int, height: int) -> tuple[np.ndarray, str]:
    """K in pixels of the image as stored, and where it comes from.

    Raises FrameFailure calibration_unreadable.
    """
    if path.is_file():
        color = _read_json(path, "calibration_unreadable").get("color")
        try:
            values = [float(color[name]) for name in _NAMES]  # type: ignore[index]
            distorted = _is_distorted(color)
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            raise FrameFailure(
                "calibration_unreadable", f"{path.name}, key 'color': {error!r}"
            ) from error
        source = f"calibration of Kinect {kinect}"
        source += ", lens distortion ignored" if distorted else ""
    else:
        values = [float(v) for v in KINECTS[kinect]]
        source = f"calibration of BEHAVE's Kinect {kinect} (no calibration file)"
    fx, fy, cx, cy, calibrated_width, calibrated_height = values
    if not all(math.isfinite(v) for v in values) or min(fx, fy, values[4], values[5]) <= 0:
        raise FrameFailure("calibration_unreadable", f"{path.name}: {values}")
    sx, sy = width / calibrated_width, height / calibrated_height
    return np.array([[fx * sx, 0, cx * sx], [0, fy * sy, cy * sy], [0, 0, 1.0]]), source


def _is_distorted(color: Any) -> bool:
    """Whether the file holds lens coefficients (``opencv``: fx fy cx cy, then those)."""
    coefficients = color.get("opencv")
    return isinstance(coefficients, list) and any(float(v) != 0 for v in coefficients[4:])


def world_to_camera(path: Path | None) -> Callable[[np.ndarray], np.ndarray]:
    """Maps (N, 3) points of the world into a Kinect's frame: the inverse of its stored pose.

    Raises FrameFailure calibration_unreadable.
    """
    if path is None:
        return lambda points: points
    pose = _read_json(path, "calibration_unreadable")
    try:
        rotation = np.asarray(pose["rotation"], float).reshape(3, 3)
        translation = np.asarray(pose["translation"], float).reshape(3)
    except (ValueError, KeyError, TypeError) as error:
        raise FrameFailure("calibration_unreadable", f"{_named(path)}: {error!r}") from error
    if (
        not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
        or not np.isfinite(translation).all()
    ):
        raise FrameFailure(
            "calibration_unreadable", f"{_named(path)}, key 'rotation' or 'translation': no pose"
        )
    return lambda points: ((points - translation) @ rotation).astype(np.float32)


def _named(path: Path) -> str:
    return "/".join(path.parts[-4:])


def _read_json(path: Path, status: str) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise FrameFailure(status, f"{_named(path)}: {error!r}") from error
    if not isinstance(content, dict):
        raise FrameFailure(status, f"{_named(path)}: holds a {type(content).__name__}, not keys")
    return content
