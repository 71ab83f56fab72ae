"""The energy of SMPLify and its normal equations, for many bodies at once.

E = E_J + E_theta + E_beta (Eq. 1), E_J being the robust squared distance of projected keypoints
(Eq. 2, perspective), and two additions that break the depth ambiguity of a single view: the
detector's 3D landmarks, where it has them, and a weak preference for an upright pelvis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from hoi.body.jacobian import KeypointKinematics, Posed
from hoi.body.keypoints import KEYPOINT
from hoi.geometry.camera import NEAR
from hoi.smplify.config import SmplifyConfig
from hoi.smplify.prior import PosePrior

HIPS = (KEYPOINT["left_hip"], KEYPOINT["right_hip"])
UP_IN_CAMERA = (0.0, -1.0, 0.0)


class Bodies(NamedTuple):
    """The parameters of B bodies in the camera frame."""

    root: Tensor  # (B, 3, 3)
    body_pose: Tensor  # (B, 69) radians
    betas: Tensor  # (B, K)
    transl: Tensor  # (B, 3) metres

    def select(self, index: Tensor | list[int]) -> Bodies:
        return Bodies(*(field[index] for field in self))

    def stepped(self, step: Tensor) -> Bodies:
        """Bodies moved by (B, 72 + K + 3) parameter steps, in the order of the derivative."""
        from hoi.geometry import axis_angle_to_matrix

        return Bodies(
            axis_angle_to_matrix(step[:, :3]) @ self.root,
            self.body_pose + step[:, 3:72],
            self.betas + step[:, 72:-3],
            self.transl + step[:, -3:],
        )


@dataclass(frozen=True)
class Observation:
    """What one frame says about the body."""

    intrinsics: Tensor  # (3, 3) pixels
    keypoints: Tensor  # (21, 2) pixels
    confidence: Tensor  # (21,) zero where there is none
    landmarks: Tensor | None  # (21, 3) metres, camera axes, at the size of the average body
    landmark_confidence: Tensor  # (21,)
    pixels_per_metre: float  # at the person's depth: turns pixel errors into lengths


class Energy:
    """The terms of one observation."""

    def __init__(
        self,
        config: SmplifyConfig,
        kinematics: KeypointKinematics,
        prior: PosePrior,
        observation: Observation,
        robust_m: float,
    ):
        self._config = config
        self._kinematics = kinematics
        self._prior = prior
        self._seen = observation
        self._robust = robust_m

    def with_robust_scale(self, robust_m: float) -> Energy:
        return Energy(self._config, self._kinematics, self._prior, self._seen, robust_m)

    def terms(self, bodies: Bodies, posed: Posed | None = None) -> dict[str, Tensor]:
        """Every term, weighted, (B,) each. Their sum is the energy."""
        config = self._config
        posed = posed or self.posed(bodies)
        squared = self._keypoint_errors(posed, bodies).square().sum(-1)
        pose, limits = self._prior.energies(bodies.body_pose)
        terms = {
            "keypoints": self._keypoint_weight()
            * _geman_mcclure(squared, self._robust)
            @ self._seen.confidence,
            "pose": pose,
            "limits": limits,
            "shape": config.shape_weight * bodies.betas.square().sum(1),
            "upright": self._upright_weight() * self._tilt(posed).square().sum(1),
        }
        if self._uses_landmarks():
            squared = self._landmark_errors(posed).square().sum(-1)
            robust = _geman_mcclure(squared, config.landmark_robust_m)
            terms["landmarks"] = self._landmark_weight() * robust @ self._seen.landmark_confidence
        return terms

    def normal_equations(self, bodies: Bodies, posed: Posed) -> tuple[Tensor, Tensor]:
        """Half the gradient (B, P) and the Gauss-Newton matrix (B, P, P) of the energy.

        Robust terms enter with the weight that makes their gradient exact (iteratively reweighted
        least squares).
        """
        config, count = self._config, len(bodies.betas)
        size = posed.derivative.shape[-1] + 3
        gradient = torch.zeros(count, size, dtype=posed.keypoints.dtype)
        matrix = torch.zeros(count, size, size, dtype=posed.keypoints.dtype)

        errors = self._keypoint_errors(posed, bodies)
        weights = self._keypoint_weight() * self._seen.confidence
        weights = weights * _geman_mcclure_weight(errors.square().sum(-1), self._robust)
        _accumulate(gradient, matrix, self._projection_derivative(posed, bodies), errors, weights)
        if self._uses_landmarks():
            errors = self._landmark_errors(posed)
            robust = _geman_mcclure_weight(errors.square().sum(-1), config.landmark_robust_m)
            weights = self._landmark_weight() * self._seen.landmark_confidence * robust
            derivative = posed.derivative - posed.derivative[:, HIPS].mean(1, keepdim=True)
            inner = gradient[:, :-3], matrix[:, :-3, :-3]
            _accumulate(*inner, derivative, errors, weights)

        pose_gradient, pose_curvature = self._prior.normal_equations(bodies.body_pose)
        gradient[:, 3:72] += pose_gradient
        gradient[:, 72:-3] += config.shape_weight * bodies.betas
        diagonal = matrix.diagonal(dim1=1, dim2=2)
        diagonal[:, 3:72] += pose_curvature
        diagonal[:, 72:-3] += config.shape_weight

        turn = -_cross_matrix(posed.up)
        gradient[:, :3] += self._upright_weight() * (self._tilt(posed)[:, None] @ turn)[:, 0]
        matrix[:, :3, :3] += self._upright_weight() * turn.transpose(1, 2) @ turn
        return gradient, matrix

    def posed(self, bodies: Bodies) -> Posed:
        return self._kinematics(bodies.root, bodies.body_pose, bodies.betas)

    def reprojection_error_px(self, bodies: Bodies) -> Tensor:
        """Mean distance (B,) between seen and projected keypoints, weighted by confidence."""
        metres = self._keypoint_errors(self.posed(bodies), bodies).norm(dim=-1)
        total = self._seen.confidence.sum()
        return metres @ self._seen.confidence / total * self._seen.pixels_per_metre

    def _keypoint_errors(self, posed: Posed, bodies: Bodies) -> Tensor:
        """(B, 21, 2) reprojection errors as lengths at the person's depth."""
        points = posed.keypoints + bodies.transl[:, None]
        focal, centre = self._focal_and_centre()
        image = points[..., :2] / points[..., 2:].clamp(min=NEAR) * focal + centre
        return (image - self._seen.keypoints) / self._seen.pixels_per_metre

    def _projection_derivative(self, posed: Posed, bodies: Bodies) -> Tensor:
        """(B, 21, 2, P) derivative of `_keypoint_errors`."""
        points = posed.keypoints + bodies.transl[:, None]
        depth = points[..., 2:].clamp(min=NEAR)
        focal, _ = self._focal_and_centre()
        scale = focal / depth / self._seen.pixels_per_metre  # (B, 21, 2)
        slope = points[..., :2] / depth
        identity = torch.eye(3, dtype=points.dtype).expand(*points.shape[:2], 3, 3)
        moved = torch.cat([posed.derivative, identity], dim=-1)
        return scale[..., None] * (moved[..., :2, :] - slope[..., None] * moved[..., 2:, :])

    def _focal_and_centre(self) -> tuple[Tensor, Tensor]:
        matrix = self._seen.intrinsics
        return torch.stack([matrix[0, 0], matrix[1, 1]]), matrix[:2, 2]

    def _landmark_errors(self, posed: Posed) -> Tensor:
        """(B, 21, 3) metres, both sides centred between the hips."""
        assert self._seen.landmarks is not None
        centred = posed.keypoints - posed.keypoints[:, HIPS].mean(1, keepdim=True)
        return centred - self._seen.landmarks

    def _tilt(self, posed: Posed) -> Tensor:
        return posed.up - torch.tensor(UP_IN_CAMERA, dtype=posed.up.dtype)

    def _uses_landmarks(self) -> bool:
        return self._seen.landmarks is not None and self._config.landmark_weight > 0

    def _keypoint_weight(self) -> float:
        return self._config.keypoint_weight / self._config.keypoint_sd_m**2

    def _landmark_weight(self) -> float:
        return self._config.landmark_weight / self._config.landmark_sd_m**2

    def _upright_weight(self) -> float:
        return self._config.upright_weight / math.radians(self._config.upright_sd_deg) ** 2


def _accumulate(
    gradient: Tensor, matrix: Tensor, derivative: Tensor, errors: Tensor, weights: Tensor
) -> None:
    """Add sum_k w_k J_k^T r_k and sum_k w_k J_k^T J_k over points k, in place."""
    batch, points, dims, size = derivative.shape
    root = weights.sqrt()[:, :, None]
    rows = (derivative * root[..., None]).reshape(batch, points * dims, size)
    values = (errors * root).reshape(batch, points * dims, 1)
    gradient += (rows.transpose(1, 2) @ values)[..., 0]
    matrix += rows.transpose(1, 2) @ rows


def _geman_mcclure(squared: Tensor, scale: float) -> Tensor:
    """e^2 s^2 / (s^2 + e^2): quadratic near zero, at most s^2."""
    return squared * scale**2 / (scale**2 + squared)


def _geman_mcclure_weight(squared: Tensor, scale: float) -> Tensor:
    """Its derivative by e^2."""
    return (scale**2 / (scale**2 + squared)).square()


def _cross_matrix(vector: Tensor) -> Tensor:
    """(B, 3, 3) with M x = vector x x."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).view(-1, 3, 3)
