"""E_theta: which poses people take. Joint limits, and closeness to poses of a database."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from hoi.body.skeleton import JOINT, JOINT_NAMES, NUM_JOINTS, mirror_pose
from hoi.errors import AssetError
from hoi.smplify.config import SmplifyConfig

#: Range of motion, degrees, of axis-angle x, y, z about SMPL's T-pose; textbook values, rounded,
#: for the left side and the middle. In this frame knees bend about +x, the left elbow about -y,
#: hips flex about -x. Knees and elbows bend one way only, which is what keeps SMPLify from
#: hyperextending them.
_RANGE_DEG: dict[str, tuple[tuple[float, float], ...]] = {
    "hip": ((-130, 35), (-45, 45), (-35, 60)),
    "knee": ((-3, 150), (-12, 12), (-10, 10)),
    "ankle": ((-50, 45), (-25, 25), (-20, 20)),
    "foot": ((-30, 30), (-10, 10), (-10, 10)),
    "spine1": ((-20, 40), (-25, 25), (-20, 20)),
    "spine2": ((-15, 30), (-20, 20), (-20, 20)),
    "spine3": ((-15, 30), (-20, 20), (-20, 20)),
    "neck": ((-35, 35), (-40, 40), (-25, 25)),
    "head": ((-35, 35), (-40, 40), (-25, 25)),
    "collar": ((-10, 10), (-20, 20), (-15, 30)),
    "shoulder": ((-80, 80), (-140, 50), (-105, 110)),
    "elbow": ((-70, 70), (-150, 3), (-25, 25)),
    "wrist": ((-50, 50), (-45, 45), (-70, 70)),
    "hand": ((-10, 10), (-10, 10), (-10, 10)),
}


def joint_ranges() -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits (69,) of the body pose, radians."""
    left = np.zeros((NUM_JOINTS, 3, 2))
    for name, index in JOINT.items():
        if name != "pelvis":
            left[index] = _RANGE_DEG[name.removeprefix("left_").removeprefix("right_")]
    lower, upper = np.deg2rad(left[1:, :, 0]).ravel(), np.deg2rad(left[1:, :, 1]).ravel()
    # mirroring negates y and z, which swaps their lower and upper limits
    mirrored = np.sort(np.stack([mirror_pose(lower), mirror_pose(upper)]), axis=0)
    is_right = np.repeat([name.startswith("right_") for name in JOINT_NAMES[1:]], 3)
    return np.where(is_right, mirrored[0], lower), np.where(is_right, mirrored[1], upper)


@dataclass(frozen=True)
class PoseDatabase:
    """Labelled poses: identifiers (N,) and body poses (N, 69) in radians."""

    pose_ids: tuple[str, ...]
    body_pose: np.ndarray


def read_pose_database(path: Path | str) -> PoseDatabase:
    """Read identifiers and poses of a pose database; raises AssetError."""
    path = Path(path)
    if not path.is_file():
        raise AssetError(f"{path}: no such pose database; set its path or build it first")
    try:
        with np.load(path, allow_pickle=False) as archive:
            identifiers = [str(name) for name in archive["pose_ids"]]
            poses = np.asarray(archive["body_pose"], dtype=np.float64)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise AssetError(f"{path}: not a readable pose database: {error}") from error
    if poses.ndim != 2 or poses.shape[1] != 69 or len(poses) != len(identifiers) or not len(poses):
        raise AssetError(
            f"{path}: the key 'body_pose' has shape {poses.shape}, expected ({len(identifiers)}, "
            "69) with one row at least"
        )
    if not np.isfinite(poses).all():
        raise AssetError(f"{path}: the key 'body_pose' holds NaN or infinity")
    return PoseDatabase(tuple(identifiers), poses)


def most_different(poses: np.ndarray, count: int) -> np.ndarray:
    """Indices of up to `count` poses: the one nearest the mean, then always the farthest left."""
    distance = np.linalg.norm(poses - poses.mean(0), axis=1)
    chosen = [int(distance.argmin())]
    gap = np.linalg.norm(poses - poses[chosen[0]], axis=1)
    while len(chosen) < count and gap.max() > 1e-6:
        chosen.append(int(gap.argmax()))
        gap = np.minimum(gap, np.linalg.norm(poses - poses[chosen[-1]], axis=1))
    return np.array(chosen)


class PosePrior:
    """Negative log-likelihood of a body pose, as squared residuals in standard deviations.

    A mixture: one Gaussian around every database pose, its width a share of each joint's range of
    motion, and one broad Gaussian around their mean at a price, so that a pose the database does
    not know is allowed. As in SMPLify's mixture prior the cheapest component speaks alone. Widths
    come from anatomy and not from the samples, so a database of one pose already works.
    """

    def __init__(self, poses: np.ndarray, config: SmplifyConfig, dtype=torch.float64):
        """Use (N, 69) poses, radians, as centres."""
        lower, upper = joint_ranges()
        self._lower = torch.as_tensor(lower, dtype=dtype)
        self._upper = torch.as_tensor(upper, dtype=dtype)
        span = self._upper - self._lower
        centres = np.concatenate([poses, poses.mean(0, keepdims=True)])
        self._centres = torch.as_tensor(centres, dtype=dtype)
        kernel = (config.pose_kernel_width * span).expand(len(poses), -1)
        deviations = torch.cat([kernel, config.pose_broad_width * span[None]])
        self._precision = deviations.reciprocal().square()
        self._weighted_centres = self._precision * self._centres
        self._constant = (self._weighted_centres * self._centres).sum(1)
        self._constant[-1] += config.pose_broad_penalty
        self._limit_sd = float(np.deg2rad(config.limit_sd_deg))
        self._config = config

    def closest(self, body_pose: Tensor) -> Tensor:
        """Index (B,) of the component that explains each pose (B, 69) best."""
        return self._component_energies(body_pose).argmin(1)

    def energies(self, body_pose: Tensor) -> tuple[Tensor, Tensor]:
        """Energies (B,) of closeness to the database and of the joint limits."""
        config = self._config
        closeness = self._component_energies(body_pose).amin(1)
        beyond = self._beyond(body_pose) / self._limit_sd
        return config.pose_weight * closeness, config.limit_weight * beyond.square().sum(1)

    def normal_equations(self, body_pose: Tensor) -> tuple[Tensor, Tensor]:
        """Gradient and diagonal Gauss-Newton curvature (both half the derivative), each (B, 69)."""
        config = self._config
        index = self.closest(body_pose)
        precision = config.pose_weight * self._precision[index]
        gradient = precision * (body_pose - self._centres[index])
        beyond = self._beyond(body_pose)
        stiffness = config.limit_weight / self._limit_sd**2
        curvature = precision + stiffness * (beyond != 0)
        return gradient + stiffness * beyond, curvature

    def _component_energies(self, body_pose: Tensor) -> Tensor:
        """(B, N + 1), by the expanded square: one matrix product whatever the database's size."""
        squares = body_pose.square() @ self._precision.T
        return squares - 2 * body_pose @ self._weighted_centres.T + self._constant

    def _beyond(self, body_pose: Tensor) -> Tensor:
        """How far each angle is outside its range, signed; zero inside."""
        above = (body_pose - self._upper).clamp(min=0)
        return above - (self._lower - body_pose).clamp(min=0)
