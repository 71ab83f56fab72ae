"""SMPL bodies of other systems: PARE, 4D-Humans (and PHALP), FrankMocap, plain SMPL files.

All of them regress SMPL's pose in the frame of the camera, seen from a crop of the picture; the
body fit starts from it. Their cameras are not used: translation is solved from the keypoints.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hoi.errors import AssetError
from hoi.readers.config import BodyFiles
from hoi.readers.files import entry, listed, numbers, read_json, read_npz
from hoi.readers.paths import FrameNames, fill
from hoi.readers.pickles import read_plain_pickle

_JOINTS = 24
_MOST_PEOPLE = 64
_PICKLES = (".pkl", ".pickle", ".joblib")


class Bodies(NamedTuple):
    """P people: poses (P, 24, 3) axis-angle in the camera frame, the root first; betas (P, K)."""

    poses: np.ndarray
    betas: np.ndarray


def read_bodies(files: BodyFiles, names: FrameNames, root: Path) -> Bodies:
    """The bodies of one frame; raises AssetError naming file and key."""
    path = fill(files.path, names, root)
    readers: dict[str, Callable[[], Bodies]] = {
        "pare": lambda: _pare(path),
        "four_d_humans": lambda: _four_d_humans(path, names),
        "frankmocap": lambda: _frankmocap(path),
        "smpl": lambda: _smpl(_content(path), path),
    }
    bodies = readers[files.format]()
    if not 0 < len(bodies.poses) <= _MOST_PEOPLE:
        raise AssetError(f"{path}: holds {len(bodies.poses)} bodies for {names.file!r}")
    return bodies


def _content(path: Path) -> Any:
    """The content of a json, npz or pickle file, by its suffix."""
    suffix = path.suffix.lower()
    if suffix == ".json":
        return read_json(path)
    if suffix == ".npz":
        return read_npz(path)
    if suffix in _PICKLES:
        return read_plain_pickle(path)
    raise AssetError(f"{path}: expected a .json, .npz or {', '.join(_PICKLES)} file")


def _pare(path: Path) -> Bodies:
    """``pare_results/<image>.pkl`` of PARE's image folder mode: all people of one image.

    Its video file, people by number with ``pose`` and ``frame_ids``, names no photo.
    """
    content = _content(path)
    if isinstance(content, dict) and "pred_pose" not in content:
        people = [value for value in content.values() if isinstance(value, dict)]
        if any("frame_ids" in person for person in people):
            raise AssetError(
                f"{path}: key 'pred_pose' is missing; this is PARE's file of a video. "
                "Run it with --mode folder, which writes one file a photo"
            )
    poses = _rotations(entry(content, "pred_pose", path), "pred_pose", path)
    return _checked(poses, entry(content, "pred_shape", path), "pred_shape", path)


def _four_d_humans(path: Path, names: FrameNames) -> Bodies:
    """``pred_smpl_params`` saved from the demo, or the tracks of PHALP (``results/demo_*.pkl``)."""
    content = _content(path)
    if isinstance(content, dict) and "pred_smpl_params" in content:
        content = content["pred_smpl_params"]
    if isinstance(content, dict) and "global_orient" not in content:
        content = _phalp_frame(content, names, path)
        people = listed(entry(content, "smpl", path), "smpl", path)
        if not people:
            raise AssetError(f"{path}: key 'smpl' of {names.file!r} is empty: nobody was tracked")
        parts = [_hmr_person(person, path) for person in people[:_MOST_PEOPLE]]
        return Bodies(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
    return _hmr_person(content, path)


def _phalp_frame(tracks: dict[Any, Any], names: FrameNames, path: Path) -> Any:
    for key, frame in tracks.items():
        if isinstance(key, str) and Path(key).stem == names.stem:
            return frame
    raise AssetError(
        f"{path}: none of its {len(tracks)} keys is 'global_orient' or a frame called "
        f"{names.stem!r}"
    )


def _hmr_person(content: Any, path: Path) -> Bodies:
    """Rotation matrices: global_orient (..., 1, 3, 3), body_pose (..., 23, 3, 3); betas."""
    root = _rotations(entry(content, "global_orient", path), "global_orient", path, 1)
    body = _rotations(entry(content, "body_pose", path), "body_pose", path, _JOINTS - 1)
    if len(root) != len(body):
        raise AssetError(f"{path}: keys 'global_orient' and 'body_pose' differ in people")
    poses = np.concatenate([root, body], axis=1)
    return _checked(poses, entry(content, "betas", path), "betas", path)


def _frankmocap(path: Path) -> Bodies:
    """BEHAVE's ``k1.mocap.json`` (pose, betas), or FrankMocap's own ``*_prediction_result.pkl``."""
    content = _content(path)
    if isinstance(content, dict) and "pred_output_list" in content:
        people = listed(content["pred_output_list"], "pred_output_list", path)
        poses = [
            _axis_angles(entry(p, "pred_body_pose", path), "pred_body_pose", path) for p in people
        ]
        betas = [_rows(entry(p, "pred_betas", path), "pred_betas", path) for p in people]
        if not people or len({rows.shape[1] for rows in betas}) > 1:
            raise AssetError(f"{path}: key 'pred_output_list' holds no usable person")
        return _checked(np.concatenate(poses), np.concatenate(betas), "pred_betas", path)
    return _smpl(content, path)


def _smpl(content: Any, path: Path) -> Bodies:
    """``pose`` (72 numbers, 156 of SMPL-H) or ``global_orient`` and ``body_pose``; ``betas``."""
    if isinstance(content, dict) and "pose" not in content and "global_orient" in content:
        root = numbers(content["global_orient"], "global_orient", path)
        body = numbers(entry(content, "body_pose", path), "body_pose", path)
        root = root.reshape(-1, 3) if root.size % 3 == 0 else root[..., :0]
        if not root.size or not body.size or body.size % len(root):
            raise AssetError(f"{path}: keys 'global_orient' and 'body_pose' differ in people")
        flat: Any = np.concatenate([root, body.reshape(len(root), -1)], axis=1)
        poses = _axis_angles(flat, "body_pose", path)
    else:
        poses = _axis_angles(entry(content, "pose", path), "pose", path)
    return _checked(poses, entry(content, "betas", path), "betas", path)


def _axis_angles(value: Any, key: str, path: Path) -> np.ndarray:
    """(P, 24, 3) of 72 numbers a person, 66 or 69 without hands, or 156 with fingers."""
    flat = _rows(value, key, path)
    count = flat.shape[1]
    if count not in (66, 69, 72, 156):
        raise AssetError(f"{path}: key {key!r} holds {count} numbers a person, expected 72 or 156")
    body = np.zeros((len(flat), 3 * _JOINTS))
    if count == 156:  # SMPL-H's fingers: the wrists' own rotation says where a hand points
        body[:, :66] = flat[:, :66]
    else:
        body[:, :count] = flat
    if np.abs(body).max(initial=0) > 100:
        raise AssetError(f"{path}: key {key!r} holds {np.abs(body).max():.3g}, no angle in radians")
    return body.reshape(len(flat), _JOINTS, 3)


def _rows(value: Any, key: str, path: Path) -> np.ndarray:
    """(P, N): one row a person; a single list of numbers is of one."""
    values = numbers(value, key, path)
    if not values.size or not values.ndim:
        raise AssetError(f"{path}: key {key!r} has shape {values.shape}, expected rows of numbers")
    return values.reshape(1 if values.ndim == 1 else len(values), -1)


def _rotations(value: Any, key: str, path: Path, joints: int = _JOINTS) -> np.ndarray:
    """(P, joints, 3) axis-angle of rotation matrices (..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    matrices = numbers(value, key, path)
    if matrices.shape[-2:] != (3, 3) or matrices.size % (9 * joints) or not matrices.size:
        raise AssetError(
            f"{path}: key {key!r} has shape {matrices.shape}, expected {joints} rotation matrices "
            "a person"
        )
    flat = matrices.reshape(-1, 3, 3)
    off = np.abs(flat @ flat.transpose(0, 2, 1) - np.eye(3)).max()
    if off > 1e-2 or (np.linalg.det(flat) < 0).any():
        raise AssetError(
            f"{path}: key {key!r} holds matrices that are no rotations (off by {off:.3g})"
        )
    return Rotation.from_matrix(flat).as_rotvec().reshape(-1, joints, 3)


def _checked(poses: np.ndarray, betas: Any, key: str, path: Path) -> Bodies:
    shapes = _rows(betas, key, path)
    if len(shapes) != len(poses) or shapes.shape[1] > 300:
        raise AssetError(f"{path}: key {key!r} has shape {shapes.shape} for {len(poses)} people")
    return Bodies(poses, shapes)
