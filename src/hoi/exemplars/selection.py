"""Representative exemplars of a category: k-means++ over signed distance grids [paper 3.5]."""

from __future__ import annotations

from typing import Any

import numpy as np

from hoi.exemplars.ray_surface import RaySurface


def unit_box(vertices: np.ndarray) -> np.ndarray:
    """Centre (V, 3) vertices and scale each axis so that the bounding box is [-0.5, 0.5]^3.

    An axis without extent keeps its length [paper 3.5: anisotropic scaling into a unit box].
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = np.where(high - low > 1e-9, high - low, 1.0)
    return ((vertices - (low + high) / 2) / extent).astype(np.float32)


def grid_points(grid: int) -> np.ndarray:
    """(grid^3, 3) float32 centres of the cells of the unit box, x slowest."""
    axis = (np.arange(grid, dtype=np.float32) + 0.5) / grid - 0.5
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def signed_distances(vertices: np.ndarray, faces: np.ndarray, grid: int = 30) -> np.ndarray:
    """(grid^3,) signed distances of the unit-box cells to a closed mesh, negative inside.

    `vertices` (V, 3) in any unit are put into the unit box first; distances are in its sides. The
    sign counts ray crossings (majority of several rays), so the mesh must be watertight.
    """
    return RaySurface(unit_box(vertices), faces).signed_distances(grid_points(grid))


def representatives(features: np.ndarray, k: int, seed: int, restarts: int = 10) -> np.ndarray:
    """Sorted indices of the members nearest to the k-means++ cluster centres [paper 3.5].

    Args:
        features: (N, D) one row an object, compared by Euclidean distance.
        k: number of clusters; with N <= k every object represents itself.
        seed: of the k-means++ starts.
        restarts: starts; the clustering of least inertia is kept.

    Returns at most k indices (fewer only when two clusters share their nearest member).
    """
    from sklearn.cluster import KMeans
    from threadpoolctl import threadpool_limits

    if len(features) <= k:
        return np.arange(len(features))
    # N objects span at most N dimensions: clustering their coordinates there is the same problem.
    compact = _isometric_coordinates(features)
    with threadpool_limits(limits=1):
        options: dict[str, Any] = {"init": "k-means++", "n_init": restarts, "random_state": seed}
        clusters = KMeans(k, **options).fit(compact)
    to_centre = np.linalg.norm(compact - clusters.cluster_centers_[clusters.labels_], axis=1)
    nearest = [
        members[to_centre[members].argmin()]
        for members in (np.flatnonzero(clusters.labels_ == c) for c in range(k))
        if len(members)
    ]
    return np.unique(nearest)


def _isometric_coordinates(features: np.ndarray) -> np.ndarray:
    """(N, D) -> (N, min(N, D)) with the same pairwise distances."""
    if features.shape[1] <= len(features):
        return features.astype(np.float64)
    centred = features.astype(np.float64) - features.mean(axis=0, dtype=np.float64)
    values, vectors = np.linalg.eigh(centred @ centred.T)
    return vectors * np.sqrt(np.maximum(values, 0))
