"""Reader of BEHAVE's tree: which frames there are, and what one frame shows.

The generated set :mod:`hoi.datasets.behave_mini` has the same layout and is read by this module.
Ground truth is in :mod:`hoi.datasets.behave_truth`, cameras in
:mod:`hoi.datasets.behave_calibration`, names and places in :mod:`hoi.datasets.behave_layout`.
"""

from __future__ import annotations

import json
import pickle
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hoi.artifacts import Frame
from hoi.datasets.behave_30fps import frame_times
from hoi.datasets.behave_calibration import calibration_file, info_file, read_intrinsics
from hoi.datasets.behave_config import BehaveConfig
from hoi.datasets.behave_layout import (
    ACTION_GROUPS,
    TABLE_GROUPS,
    FrameRef,
    frame_folder,
    frame_ref,
    is_frame_folder,
    parse_sequence,
    sequence_folder,
)
from hoi.datasets.behave_truth import (
    ground_truth_files,
    object_fit,
    object_mask,
    person_fit,
    picture,
    read_ground_truth,
)
from hoi.datasets.pictures import read_image, read_mask
from hoi.errors import ConfigError, FrameFailure, NoFramesError

__all__ = [
    "FrameRef",
    "frame_files",
    "frame_ref",
    "ground_truth_files",
    "list_frames",
    "read_frame",
    "read_ground_truth",
]

_BODY25_LENGTH = 75


# ------------------------------------------------------------------------------------ listing


def list_frames(
    root: Path | str,
    category_group: str,
    split: str,
    config: BehaveConfig | None = None,
    with_ground_truth: bool = True,
) -> list[FrameRef]:
    """Frames on disk of one table group and split, sorted.

    Args:
        root: the BEHAVE folder, holding ``split.json`` and ``sequences/``.
        category_group: chair, table, keyboard or backpack, see `TABLE_GROUPS`.
        split: a key of ``split.json``, e.g. ``test``, or of the configured list of frames.
        config: which dates, which of the frames, which fits.
        with_ground_truth: only frames that have a person fit and an object fit, as in the test
            lists of later papers (BEHAVE has frames in which a fit failed).

    Raises ConfigError when the data set, group or split is not there.
    """
    config = config or BehaveConfig()
    if category_group not in TABLE_GROUPS:
        raise ConfigError(
            f"unknown category group {category_group!r}; known: {', '.join(TABLE_GROUPS)}"
        )
    listed = split_frames(root, split, config)
    wanted = [s for s in sorted(listed) if in_table(s, category_group)]
    refs: list[FrameRef] = []
    for sequence in wanted:
        times = times_on_disk(root, sequence)
        if listed[sequence] is not None:
            times = [time for time in times if time in listed[sequence]]  # type: ignore[operator]
        refs += [frame_ref(sequence, time) for time in times[:: config.every]]
    if with_ground_truth:
        refs = with_fits(root, refs, config)
    if not refs:
        origin = config.frame_list or "split.json"
        raise NoFramesError(
            f"{root}: no frames of group {category_group!r} in split {split!r}; "
            f"{len(wanted)} sequences are listed in {origin}, none of them is in "
            f"{Path(root) / 'sequences'} with fits"
        )
    return refs


def in_table(sequence: str, category_group: str) -> bool:
    """Whether a sequence's object and action belong to a result table."""
    _, _, object_name, action = parse_sequence(sequence)
    known = object_name in TABLE_GROUPS[category_group]
    return known and action in ACTION_GROUPS[object_name]


def times_on_disk(root: Path | str, sequence: str) -> list[str]:
    """The frame folders of one sequence, in order; none where it was not downloaded."""
    folder = sequence_folder(root, sequence)
    if not folder.is_dir():
        return []
    return sorted(p.name for p in folder.iterdir() if is_frame_folder(p.name))


def with_fits(
    root: Path | str, refs: Iterable[FrameRef], config: BehaveConfig | None = None
) -> list[FrameRef]:
    """Those frames that have a person fit and an object fit, in the order given."""
    config = config or BehaveConfig()
    if not config.fits_30fps:
        return [r for r in refs if person_fit(root, r) and object_fit(root, r)]
    folder = Path(config.fits_30fps).expanduser()
    known: dict[str, frozenset[str]] = {}
    kept = []
    for ref in refs:
        if ref.sequence not in known:
            try:
                known[ref.sequence] = frozenset(frame_times(folder, ref.sequence))
            except FrameFailure as failure:
                raise ConfigError(f"behave.fits_30fps: {failure.detail}") from failure
        if ref.time in known[ref.sequence]:
            kept.append(ref)
    return kept


def split_frames(
    root: Path | str, split: str, config: BehaveConfig | None = None
) -> dict[str, frozenset[str] | None]:
    """Sequence -> its frames in a split; None stands for all of its frames.

    Raises ConfigError naming the file when it is absent, damaged or has no such split.
    """
    config = config or BehaveConfig()
    if config.frame_list:
        listed = _listed_frames(Path(config.frame_list).expanduser(), split, config.kinect)
    else:
        listed = dict.fromkeys(_split_sequences(Path(root), split), None)
    if config.dates:
        listed = {s: times for s, times in listed.items() if parse_sequence(s)[0] in config.dates}
    return listed


def _split_sequences(root: Path, split: str) -> list[str]:
    path = root / "split.json"
    try:
        splits = json.loads(path.read_text(encoding="utf-8"))
        names = splits[split]
        for name in names:
            parse_sequence(name)
    except FileNotFoundError as error:
        raise ConfigError(f"{path} does not exist; is {root} a BEHAVE folder?") from error
    except KeyError as error:
        raise ConfigError(f"{path} has no split {split!r}; it has {', '.join(splits)}") from error
    except (ValueError, TypeError, RecursionError) as error:
        raise ConfigError(f"{path}: not a BEHAVE split file: {error}") from error
    return list(names)


_LISTED = re.compile(r"(?:^|/)(Date[^/]+)/(t\d+\.\d+)(?:/k(\d)\.color\.jpg)?$")


def _listed_frames(path: Path, split: str, kinect: int) -> dict[str, frozenset[str] | None]:
    """Frames by sequence from a list of paths, as later papers publish their test lists."""
    times: dict[str, set[str]] = {}
    for entry in _entries_of_list(path, split):
        match = _LISTED.search(entry.strip().replace("\\", "/"))
        if match is None:
            raise ConfigError(
                f"{path}: {entry!r} is no frame; expected .../<sequence>/<time>[/k1.color.jpg]"
            )
        sequence, time, camera = match.groups()
        try:
            frame_ref(sequence, time)
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from error
        if camera is None or int(camera) == kinect:
            times.setdefault(sequence, set()).add(time)
    return {sequence: frozenset(of) for sequence, of in times.items()}


def _entries_of_list(path: Path, split: str) -> list[str]:
    from hoi.plain_pickle import load_plain

    try:
        if path.suffix == ".pkl":
            content: Any = load_plain(path)
        elif path.suffix == ".json":
            content = json.loads(path.read_text(encoding="utf-8"))
        else:
            lines = path.read_text(encoding="utf-8").splitlines()
            content = [line for line in lines if line.strip() and not line.startswith("#")]
    except (OSError, ValueError, pickle.UnpicklingError, RecursionError) as error:
        raise ConfigError(f"behave.frame_list: {path} is not readable: {error}") from error
    if isinstance(content, dict):
        if split not in content:
            raise ConfigError(
                f"{path} has no split {split!r}; it has {', '.join(map(str, content))}"
            )
        content = content[split]
    if not isinstance(content, list) or not all(isinstance(entry, str) for entry in content):
        raise ConfigError(f"{path}: expected a list of paths, by split or plain")
    return content


# ------------------------------------------------------------------------------------- frames


def frame_files(root: Path | str, ref: FrameRef, config: BehaveConfig | None = None) -> list[Path]:
    """The existing files that :func:`read_frame` depends on, sorted, for content hashing."""
    return sorted(path for path in _candidates(root, ref, config) if path.is_file())


def _candidates(root: Path | str, ref: FrameRef, config: BehaveConfig | None) -> Iterator[Path]:
    kinect = (config or BehaveConfig()).kinect
    folder = frame_folder(root, ref)
    yield folder / f"k{kinect}.color.jpg"
    yield folder / f"k{kinect}.color.json"
    yield info_file(root, ref.sequence)
    yield calibration_file(root, ref.sequence, kinect)
    for mask in (picture(folder, f"k{kinect}.person_mask"), object_mask(folder, kinect)):
        if mask is not None:
            yield mask


def read_frame(
    root: Path | str,
    ref: FrameRef,
    config: BehaveConfig | None = None,
    dataset: str = "behave",
) -> Frame:
    """The photo, its camera, and the masks and keypoints that the data set ships.

    Masks and keypoints that are absent become None; all-zero keypoints stay zeros (BEHAVE writes
    them where OpenPose failed).

    Raises FrameFailure: image_missing, image_unreadable, calibration_unreadable,
    sequence_info_unreadable, mask_unreadable, mask_size_mismatch, person_mask_empty,
    object_mask_empty, keypoints_unreadable.
    """
    kinect = (config or BehaveConfig()).kinect
    folder = frame_folder(root, ref)
    image = read_image(folder / f"k{kinect}.color.jpg")
    height, width = image.shape[:2]
    calibration = calibration_file(root, ref.sequence, kinect)
    intrinsics, source = read_intrinsics(calibration, kinect, width, height)
    person = picture(folder, f"k{kinect}.person_mask")
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
        given_person_mask=_read_mask(person, image.shape[:2], "person_mask_empty"),
        given_object_mask=_read_mask(
            object_mask(folder, kinect), image.shape[:2], "object_mask_empty"
        ),
        given_keypoints=read_keypoints(folder / f"k{kinect}.color.json"),
    )


def _read_mask(path: Path | None, shape: tuple[int, ...], when_empty: str) -> np.ndarray | None:
    if path is None:
        return None
    mask = read_mask(path, shape)
    if not mask.any():
        raise FrameFailure(when_empty, f"{path.name} marks no pixel")
    return mask


def read_keypoints(path: Path) -> np.ndarray | None:
    """(21, 3) in the order of KEYPOINTS from an OpenPose BODY_25 file, or None when absent.

    Raises FrameFailure keypoints_unreadable.
    """
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
    except (
        *(ValueError, KeyError, TypeError, IndexError),
        *(AttributeError, OSError, OverflowError, RecursionError),
    ) as error:
        raise FrameFailure("keypoints_unreadable", f"{path.name}: {error!r}") from error
    return joints.reshape(25, 3)[np.asarray(FROM_BODY25)].astype(np.float32)
