"""The pose database: body poses whose action is known, one ``.npz`` file without pickle."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hoi.errors import AssetError

DEFAULT_DATABASE: Path = Path(__file__).parents[1] / "data" / "poses" / "database.npz"
"""The database of the package (``python -m hoi.actions.build_database`` makes it)."""

_KEYS = ("pose_ids", "categories", "actions", "body_pose")
_PELVIS_UP = "pelvis_up"


@dataclass(frozen=True)
class PoseDatabase:
    """N labelled poses.

    Attributes:
        pose_ids: (N,) unique names.
        categories: (N,) the objects the pose belongs to, separated by blanks: "chair stool".
        actions: (N,) what the person does.
        body_pose: (N, 69) float32, axis-angle of SMPL's joints 1 to 23, radians.
        pelvis_up: (N, 3) float32, the upward direction in the pelvis frame, that is how the pelvis
            is tilted whichever way the person faces; None when the poses do not tell.
    """

    pose_ids: np.ndarray
    categories: np.ndarray
    actions: np.ndarray
    body_pose: np.ndarray
    pelvis_up: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.pose_ids)

    def rows_of(self, category: str) -> np.ndarray:
        """Row numbers of the poses that belong to an object category, ascending."""
        return np.flatnonzero([category in entry.split() for entry in self.categories.tolist()])

    def all_categories(self) -> list[str]:
        """Every object category of the database, in alphabetical order."""
        return sorted({name for entry in self.categories.tolist() for name in entry.split()})

    def actions_of(self, category: str) -> list[str]:
        """The actions known of an object category, in alphabetical order."""
        return sorted(set(self.actions[self.rows_of(category)].tolist()))


def load_database(path: Path | str) -> PoseDatabase:
    """Read and check a pose database; raises AssetError naming the file and what is wrong."""
    try:
        with np.load(path, allow_pickle=False) as data:
            missing = [key for key in _KEYS if key not in data]
            if missing:
                raise AssetError(f"{path}: the pose database lacks {', '.join(missing)}")
            arrays = {key: data[key] for key in (*_KEYS, _PELVIS_UP) if key in data}
    except FileNotFoundError:
        raise AssetError(
            f"{path}: no pose database there; python -m hoi.actions.build_database makes one"
        ) from None
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise AssetError(f"{path}: not a readable pose database: {error}") from error
    return _checked(path, arrays)


def save_database(database: PoseDatabase, path: Path | str) -> None:
    """Write a database; equal content gives equal bytes."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    arrays = {key: getattr(database, key) for key in _KEYS}
    if database.pelvis_up is not None:
        arrays[_PELVIS_UP] = database.pelvis_up
    with open(path, "wb") as stream:
        np.savez_compressed(stream, **arrays)


def _checked(path: Path | str, arrays: dict[str, np.ndarray]) -> PoseDatabase:
    count = len(arrays["pose_ids"])
    for key in ("pose_ids", "categories", "actions"):
        if arrays[key].shape != (count,) or arrays[key].dtype.kind != "U":
            raise AssetError(f"{path}: {key} is not one text per pose")
    poses = arrays["body_pose"]
    if poses.shape != (count, 69) or poses.dtype.kind != "f":
        raise AssetError(f"{path}: body_pose has shape {poses.shape}, expected ({count}, 69)")
    if count == 0 or not np.isfinite(poses).all():
        raise AssetError(f"{path}: body_pose is empty or holds NaN or infinity")
    if len(set(arrays["pose_ids"].tolist())) != count:
        raise AssetError(f"{path}: pose_ids are not unique")
    if _PELVIS_UP in arrays:
        lengths = np.linalg.norm(arrays[_PELVIS_UP], axis=-1)
        if arrays[_PELVIS_UP].shape != (count, 3) or not np.allclose(lengths, 1, atol=1e-3):
            raise AssetError(f"{path}: pelvis_up is not one unit vector per pose")
    arrays["body_pose"] = poses.astype(np.float32)
    return PoseDatabase(**arrays)
