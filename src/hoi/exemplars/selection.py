"""Representative exemplars of a category: k-means++ over signed distance grids [paper 3.5]."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from hoi.exemplars.ray_surface import RaySurface

_WALL = 0.87  # nodes this near to the surface, in steps, are wall: half the diagonal of a cell
_DIMENSIONS = 512  # k-means looks at so many principal directions when there are more shapes
_BLOCK = 256  # shapes that are held in double precision at a time


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
    return _lattice(axis).reshape(-1, 3)


def _lattice(axis: np.ndarray) -> np.ndarray:
    """(n, n, n, 3) float32 points whose coordinates are those of `axis` (n,), x slowest."""
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).astype(np.float32)


def signed_distances(vertices: np.ndarray, faces: np.ndarray, grid: int = 30) -> np.ndarray:
    """(grid^3,) signed distances of the unit-box cells to a closed mesh, negative inside.

    `vertices` (V, 3) in any unit are put into the unit box first; distances are in its sides. The
    sign counts ray crossings (majority of several rays), so the mesh must be watertight.
    """
    return RaySurface(unit_box(vertices), faces).signed_distances(grid_points(grid))


def soup_signed_distances(vertices: np.ndarray, faces: np.ndarray, grid: int = 30) -> np.ndarray:
    """(grid^3,) distances of the unit-box cells to any triangles, negative in what they enclose.

    For raw meshes of sheets, holes and loose pieces, where counting ray crossings gives noise.
    Enclosed is what a flood from outside cannot reach on a lattice twice as fine, on which nodes
    nearer to the surface than half a node's diagonal are wall.
    """
    from scipy import ndimage

    surface = RaySurface(unit_box(vertices), faces)
    step = 0.5 / grid
    # the odd nodes of the lattice are the centres of the cells, and one ring around them
    axis = step * np.arange(-2, 2 * grid + 3) - 0.5
    cells = surface.distances(_lattice(axis[1::2]))
    fine = np.repeat(np.repeat(np.repeat(cells, 2, 0), 2, 1), 2, 2)
    count = len(axis)
    fine = np.pad(fine, (0, 1), mode="edge")[:count, :count, :count]
    # a node is at most a diagonal from the cell it copies: only there can it be wall
    near = fine < (_WALL + np.sqrt(3)) * step
    nodes = np.stack(np.nonzero(near), axis=-1)
    fine[near] = surface.distances(axis[nodes].astype(np.float32))
    wall = fine < _WALL * step
    regions, _ = cast(tuple[np.ndarray, int], ndimage.label(~wall))
    outside = regions == regions[0, 0, 0]
    signed = np.where(outside | wall, fine, -fine)
    return signed[3:-2:2, 3:-2:2, 3:-2:2].ravel()


def turned(features: np.ndarray, quarters: int) -> np.ndarray:
    """Signed distances (..., grid^3) of the same shapes turned about y by `quarters` of 90 degrees.

    A quarter brings +x to -z, as in `about_y` of 90 degrees.
    """
    grid = round(features.shape[-1] ** (1 / 3))
    cubes = features.reshape(*features.shape[:-1], grid, grid, grid)
    return np.ascontiguousarray(np.rot90(cubes, quarters, axes=(-1, -3))).reshape(features.shape)


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
    """(N, D) -> (N, min(N, D)) with the same pairwise distances.

    Of more than `_DIMENSIONS` shapes only the leading principal directions are kept: thousands of
    shapes lie close to them, and the clustering of all of them would take hours.
    """
    if features.shape[1] <= min(len(features), _DIMENSIONS):
        return features.astype(np.float64)
    count = len(features)
    if count <= _DIMENSIONS:
        centred = features.astype(np.float64) - features.mean(axis=0, dtype=np.float64)
        values, vectors = np.linalg.eigh(centred @ centred.T)
        return vectors * np.sqrt(np.maximum(values, 0))
    from scipy.linalg import eigh

    mean = features.mean(axis=0, dtype=np.float64)
    gram = np.empty((count, count))
    blocks = [slice(start, min(start + _BLOCK, count)) for start in range(0, count, _BLOCK)]
    for rows in blocks:
        left = features[rows] - mean
        for columns in blocks:
            if columns.start >= rows.start:
                gram[rows, columns] = left @ (features[columns] - mean).T
                gram[columns, rows] = gram[rows, columns].T
    span = (count - _DIMENSIONS, count - 1)
    values, vectors = eigh(gram, subset_by_index=span, overwrite_a=True)
    return vectors * np.sqrt(np.maximum(values, 0))
