"""Rotations as torch tensors, batched over leading dimensions. They act as ``X @ R.T``."""

from __future__ import annotations

import torch
from torch import Tensor


def axis_angle_to_matrix(axis_angle: Tensor) -> Tensor:
    """(..., 3) rotation vectors in radians -> (..., 3, 3). Rodrigues; smooth at zero."""
    squared = axis_angle.square().sum(-1)
    angle = (squared + 1e-16).sqrt()
    # sin(a)/a and (1-cos(a))/a^2, by their Taylor series near zero
    small = squared < 1e-6
    safe = torch.where(small, torch.ones_like(angle), angle)
    sinc = torch.where(small, 1 - squared / 6, torch.sin(safe) / safe)
    cosc = torch.where(small, 0.5 - squared / 24, (1 - torch.cos(safe)) / safe.square())
    x, y, z = axis_angle.unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), dim=-1)
    skew = skew.reshape(*axis_angle.shape[:-1], 3, 3)
    identity = torch.eye(3, dtype=axis_angle.dtype, device=axis_angle.device)
    return identity + sinc[..., None, None] * skew + cosc[..., None, None] * (skew @ skew)


def matrix_to_axis_angle(matrix: Tensor) -> Tensor:
    """(..., 3, 3) rotations -> (..., 3) rotation vectors, angle in [0, pi]. No gradient."""
    from scipy.spatial.transform import Rotation

    flat = matrix.detach().reshape(-1, 3, 3).double().cpu().numpy()
    vectors = torch.from_numpy(Rotation.from_matrix(flat).as_rotvec())
    return vectors.reshape(*matrix.shape[:-2], 3).to(matrix)


def rotation_6d_to_matrix(six: Tensor) -> Tensor:
    """(..., 6) -> (..., 3, 3): first two columns, orthonormalised (Zhou et al., CVPR 2019)."""
    first = torch.nn.functional.normalize(six[..., :3], dim=-1)
    second = six[..., 3:]
    second = second - (first * second).sum(-1, keepdim=True) * first
    second = torch.nn.functional.normalize(second, dim=-1)
    return torch.stack((first, second, torch.linalg.cross(first, second)), dim=-1)


def matrix_to_rotation_6d(matrix: Tensor) -> Tensor:
    """(..., 3, 3) -> (..., 6): its first two columns."""
    return torch.cat((matrix[..., :, 0], matrix[..., :, 1]), dim=-1)


def rotation_angle(first: Tensor, second: Tensor) -> Tensor:
    """Angle in radians between rotations (..., 3, 3), in [0, pi]."""
    trace = (first * second).sum((-1, -2))
    return torch.acos(((trace - 1) / 2).clamp(-1, 1))


def uniform_rotations(count: int, generator: torch.Generator) -> Tensor:
    """(count, 3, 3) rotations uniform on SO(3), from normalised Gaussian quaternions."""
    quaternion = torch.randn(count, 4, generator=generator)
    w, x, y, z = torch.nn.functional.normalize(quaternion, dim=-1).unbind(-1)
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(count, 3, 3)


def upright_rotations(
    count: int,
    generator: torch.Generator,
    pitch_deg: tuple[float, float] = (-3.0, 26.0),
    roll_deg: tuple[float, float] = (-8.0, 8.0),
    yaw_deg: tuple[float, float] = (0.0, 360.0),
) -> Tensor:
    """Camera-from-object rotations of objects that stand upright in front of a camera.

    The object's y points up in the image, its yaw is uniform over `yaw_deg`; `pitch_deg` is how far
    the camera looks down, `roll_deg` its roll. Starts for a search, not a constraint.

    Returns:
        (count, 3, 3), taking canonical objects (y up) to OpenCV axes (y down).
    """
    uniform = torch.rand(count, 3, generator=generator)
    yaw = torch.deg2rad(yaw_deg[0] + uniform[:, 0] * (yaw_deg[1] - yaw_deg[0]))
    pitch = torch.deg2rad(pitch_deg[0] + uniform[:, 1] * (pitch_deg[1] - pitch_deg[0]))
    roll = torch.deg2rad(roll_deg[0] + uniform[:, 2] * (roll_deg[1] - roll_deg[0]))
    zero = torch.zeros(count)
    about_y = axis_angle_to_matrix(torch.stack((zero, yaw, zero), -1))
    about_x = axis_angle_to_matrix(torch.stack((pitch, zero, zero), -1))
    about_z = axis_angle_to_matrix(torch.stack((zero, zero, roll), -1))
    return torch.diag(torch.tensor([1.0, -1.0, -1.0])) @ about_z @ about_x @ about_y
