"""Alignment and distance between shapes: similarity Procrustes and the Chamfer distance."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree


def similarity_procrustes(
    source: np.ndarray, target: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Similarity minimising ``|s X R^T + t - Y|^2`` with det R = +1 (Umeyama 1991).

    Args:
        source: (N, 3) points X. target: (N, 3) corresponding points Y, same unit.

    Returns:
        scale s, rotation R (3, 3), translation t (3,).

    Raises:
        ValueError: shapes differ, fewer than three points, or all source points coincide.
    """
    if source.shape != target.shape or source.ndim != 2 or len(source) < 3:
        raise ValueError(
            f"Procrustes needs two equal (N, 3) sets, got {source.shape}, {target.shape}"
        )
    source_mean, target_mean = source.mean(0), target.mean(0)
    x, y = source - source_mean, target - target_mean
    variance = (x**2).sum()
    if variance < 1e-20:
        raise ValueError("Procrustes: all source points coincide")
    u, singular, vt = np.linalg.svd(y.T @ x)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * sign) @ vt
    scale = float((singular * sign).sum() / variance)
    return scale, rotation, target_mean - scale * source_mean @ rotation.T


def sample_surface(
    vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """(count, 3) points spread uniformly by area over a triangle mesh."""
    corners = vertices[faces].astype(np.float64)
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    chosen = corners[rng.choice(len(faces), count, p=areas / areas.sum())]
    root = np.sqrt(rng.random((count, 1)))
    second = rng.random((count, 1))
    return (
        (1 - root) * chosen[:, 0]
        + root * (1 - second) * chosen[:, 1]
        + root * second * chosen[:, 2]
    )


def chamfer_distance(first: np.ndarray, second: np.ndarray) -> float:
    """Sum of both directed mean nearest-neighbour distances, not squared, not halved.

    The definition of CHORE's and RHOBIN's evaluation, which the paper's numbers follow.
    Two samples of the same surface do not score zero: 10,000 points of a person give about 1.3 cm.
    """
    to_second = KDTree(second).query(first)[0].mean()
    to_first = KDTree(first).query(second)[0].mean()
    return float(to_second + to_first)
