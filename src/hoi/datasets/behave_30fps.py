"""The 30 fps extension of BEHAVE: body and object parameters of whole sequences.

``<sequence>/smpl_fit_all.npz`` holds poses (T, 156), betas (T, 10), trans (T, 3) and frame_times
(T,) such as ``t0003.000``; ``object_fit_all.npz`` holds angles (T, 3), trans (T, 3), frame_times.
It is a registration of its own: its values are not those of the 1 fps set at the same time, and
the two files of one sequence may list different frames.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoi.datasets.behave_layout import FrameRef, is_frame_folder, parse_sequence
from hoi.errors import FrameFailure

SMPL_FILE = "smpl_fit_all.npz"
OBJECT_FILE = "object_fit_all.npz"
_WIDTHS = {
    SMPL_FILE: {"poses": 156, "betas": 10, "trans": 3},
    OBJECT_FILE: {"angles": 3, "trans": 3},
}


class Fit(NamedTuple):
    """Body and object parameters of one frame, in the world of Kinect 1; metres, radians."""

    pose: np.ndarray  # (156,)
    betas: np.ndarray  # (10,)
    trans: np.ndarray  # (3,)
    object_angle: np.ndarray  # (3,)
    object_trans: np.ndarray  # (3,)


def fit_files(folder: Path | str, sequence: str) -> tuple[Path, Path]:
    """The two files of one sequence; the name is checked, so they lie inside `folder`."""
    parse_sequence(sequence)
    return Path(folder) / sequence / SMPL_FILE, Path(folder) / sequence / OBJECT_FILE


def frame_times(folder: Path | str, sequence: str) -> tuple[str, ...]:
    """The frames for which both files have a fit, in order; empty when a file is not there.

    Raises FrameFailure ground_truth_unreadable.
    """
    files = fit_files(folder, sequence)
    if not all(path.is_file() for path in files):
        return ()
    first, second = (_times(path, _load(path)) for path in files)
    both = set(second)
    return tuple(time for time in first if time in both)


def read_fit(folder: Path | str, ref: FrameRef) -> Fit:
    """The parameters of one frame.

    Raises FrameFailure ground_truth_missing or ground_truth_unreadable, naming file and key.
    """
    smpl, thing = (_row(path, ref) for path in fit_files(folder, ref.sequence))
    return Fit(smpl["poses"], smpl["betas"], smpl["trans"], thing["angles"], thing["trans"])


def _row(path: Path, ref: FrameRef) -> dict[str, np.ndarray]:
    if not path.is_file():
        raise FrameFailure("ground_truth_missing", f"{ref.sequence} has no {path.name}")
    content = _load(path)
    times = _times(path, content)
    if ref.time not in times:
        raise FrameFailure("ground_truth_missing", f"{path.name} has no frame {ref.time}")
    index = times.index(ref.time)
    rows = {}
    for key, width in _WIDTHS[path.name].items():
        values = content.get(key)
        if values is None:
            raise _unreadable(path, f"the key {key!r} is missing")
        if values.dtype.kind not in "fiu" or values.shape != (len(times), width):
            raise _unreadable(
                path, f"the key {key!r} has shape {values.shape}, expected ({len(times)}, {width})"
            )
        if not np.isfinite(values[index]).all():
            raise _unreadable(path, f"the key {key!r} holds NaN or infinity")
        rows[key] = values[index].astype(np.float64)
    return rows


def _times(path: Path, content: dict[str, np.ndarray]) -> list[str]:
    times = content.get("frame_times")
    if times is None:
        raise _unreadable(path, "the key 'frame_times' is missing")
    names = [str(time) for time in np.atleast_1d(times)]
    if times.dtype.kind != "U" or not all(map(is_frame_folder, names)):
        raise _unreadable(path, "the key 'frame_times' does not hold names such as t0003.000")
    return names


def _load(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            wanted = (*_WIDTHS[path.name], "frame_times")
            return {key: archive[key] for key in wanted if key in archive.files}
    except Exception as error:  # whatever zip, zlib and numpy make of damaged bytes
        raise _unreadable(path, repr(error)) from error


def _unreadable(path: Path, what: str) -> FrameFailure:
    return FrameFailure("ground_truth_unreadable", f"{path.parent.name}/{path.name}: {what}")
