"""Levenberg-Marquardt on many bodies at once, each with its own damping."""

from __future__ import annotations

import torch
from torch import Tensor

from hoi.smplify.energy import Bodies, Energy

#: Damping acts on the diagonal plus this, so that parameters nothing constrains stay put.
_FLOOR = 1e-3
_SMALLEST, _LARGEST = 1e-7, 1e7
#: It is over when for this many steps no energy fell by more than this share.
_PATIENCE, _TOLERANCE = 3, 1e-3


def minimise(
    energy: Energy,
    bodies: Bodies,
    iterations: int,
    initial_damping: float,
    camera_only: bool = False,
) -> tuple[Bodies, Tensor]:
    """Lower the energy of every body; a step that does not lower it is not taken.

    Args:
        energy: what to minimise.
        bodies: B starts.
        iterations: most steps tried.
        initial_damping: relative to the curvature.
        camera_only: move root rotation and translation alone.
    Returns:
        the bodies and their energies (B,).
    """
    posed = energy.posed(bodies)
    value = _total(energy, bodies, posed)
    damping = torch.full_like(value, initial_damping)
    stalled = torch.zeros_like(value)
    for _ in range(iterations):
        gradient, matrix = energy.normal_equations(bodies, posed)
        step = _solve(gradient, matrix, damping, camera_only)
        trial = bodies.stepped(step)
        trial_posed = energy.posed(trial)
        trial_value = _total(energy, trial, trial_posed)
        better = trial_value < value
        bodies = Bodies(*_choose(better, trial, bodies))
        posed = type(posed)(*_choose(better, trial_posed, posed))
        gained = (value - trial_value) > _TOLERANCE * value
        stalled = torch.where(gained, torch.zeros_like(stalled), stalled + 1)
        value = torch.where(better, trial_value, value)
        damping = torch.where(better, damping / 4, damping * 6).clamp(_SMALLEST, _LARGEST)
        if bool((stalled >= _PATIENCE).all()):
            break
    return bodies, value


def _total(energy: Energy, bodies: Bodies, posed) -> Tensor:
    total = torch.stack(list(energy.terms(bodies, posed).values())).sum(0)
    return torch.where(torch.isfinite(total), total, torch.inf)


def _solve(gradient: Tensor, matrix: Tensor, damping: Tensor, camera_only: bool) -> Tensor:
    step = torch.zeros_like(gradient)
    size = gradient.shape[1]
    free = [0, 1, 2, size - 3, size - 2, size - 1] if camera_only else list(range(size))
    gradient, matrix = gradient[:, free], matrix[:, free][:, :, free]
    diagonal = matrix.diagonal(dim1=1, dim2=2)
    damped = matrix + torch.diag_embed(damping[:, None] * (diagonal + _FLOOR))
    factor, failed = torch.linalg.cholesky_ex(damped)
    solved = torch.cholesky_solve(-gradient[..., None], factor)[..., 0]
    # a matrix that lost definiteness to rounding gets no step; its damping rises instead
    usable = (failed == 0)[:, None] & torch.isfinite(solved)
    step[:, free] = torch.where(usable, solved, torch.zeros_like(solved))
    return step


def _choose(better: Tensor, new: tuple[Tensor, ...], old: tuple[Tensor, ...]) -> list[Tensor]:
    return [
        torch.where(better.view(-1, *[1] * (a.ndim - 1)), a, b)
        for a, b in zip(new, old, strict=True)
    ]
