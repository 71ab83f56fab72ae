"""Any triangle soup -> one watertight mesh of about a thousand vertices.

The paper reconstructs its meshes from sampled points by ball pivoting; on a thousand points that
tears thin legs and slats apart. A closed level set of the distance to the raw surface keeps them.
"""

from __future__ import annotations

import importlib
from typing import Any, cast

import numpy as np

from hoi.errors import AssetError
from hoi.exemplars.ray_surface import RaySurface

CELLS = 80  # along the longest side: a chair gets cells of about one centimetre
_LEVEL = 0.9  # level set at this many cells from the surface: closes gaps up to twice as wide
_WALL = 0.87  # cells this near to the surface are wall: half the diagonal of a cell
_REST = 0.25  # cells of thickness left by the final shrink, so that sheets keep two sides


def remesh(
    vertices: np.ndarray, faces: np.ndarray, method: str, target_vertices: int = 1000
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`watertight_remesh` or, for method ``ball_pivoting``, the paper's reconstruction."""
    if method == "watertight":
        return watertight_remesh(vertices, faces, target_vertices)
    from hoi.exemplars.ball_pivoting import ball_pivoting_remesh

    return ball_pivoting_remesh(vertices, faces, target_vertices)


def watertight_remesh(
    vertices: np.ndarray, faces: np.ndarray, target_vertices: int = 1000, cells: int = CELLS
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Re-mesh a surface with holes, sheets and self-intersections into a closed solid.

    Distance field on a voxel grid, inside found by flood fill, marching cubes a little outside
    the surface, quadric decimation, and vertices pulled back to the raw surface.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3).
        target_vertices: wanted vertex count (met within a few per cent).
        cells: grid cells along the longest side of the bounding box.

    Returns vertices (V', 3) float32, faces (F', 3) int64 with outward orientation, and for each
    new face the index (F',) of the nearest raw face. Raises AssetError when no closed surface
    comes out.
    """
    raw = RaySurface(vertices, faces)
    dense, spacing = _level_set(raw, vertices[np.unique(faces)], cells)
    points, triangles = _decimated(dense, 2 * target_vertices)
    surface, _ = raw.closest(points)
    offset = points - surface
    distance = np.linalg.norm(offset, axis=1, keepdims=True)
    rest = np.minimum(distance, _REST * spacing) / np.maximum(distance, 1e-9)
    points = (surface + offset * rest).astype(np.float32)
    if not is_closed(points, triangles):
        raise AssetError("re-meshing gave a surface with holes; is the mesh larger than a point?")
    _, nearest = raw.closest(points[triangles].mean(axis=1))
    return points, triangles, nearest


def is_closed(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether a mesh is watertight, consistently wound and encloses a positive volume."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return bool(mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0)


def _decimated(mesh: Any, faces: int) -> tuple[np.ndarray, np.ndarray]:
    """Quadric edge collapse; open3d's keeps closed meshes closed."""
    open3d: Any = importlib.import_module("open3d")
    dense = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.asarray(mesh.vertices)),
        open3d.utility.Vector3iVector(np.asarray(mesh.faces)),
    )
    coarse = dense.simplify_quadric_decimation(faces)
    return np.asarray(coarse.vertices), np.asarray(coarse.triangles, np.int64)


def _level_set(raw: RaySurface, points: np.ndarray, cells: int) -> tuple[Any, float]:
    """The outer level set around a surface as a trimesh, and the grid spacing in metres."""
    import trimesh
    from scipy import ndimage
    from skimage.measure import marching_cubes

    low, high = points.min(axis=0), points.max(axis=0)
    spacing = float((high - low).max()) / cells
    if not spacing > 0:
        raise AssetError("the mesh has no extent")
    margin = 3
    counts = np.ceil((high - low) / spacing).astype(int) + 2 * margin + 1
    axes = [low[k] + spacing * (np.arange(counts[k]) - margin) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    distance = raw.distances(grid)
    wall = distance < _WALL * spacing
    regions, _ = cast(tuple[np.ndarray, int], ndimage.label(~wall))
    outside = regions == regions[0, 0, 0]
    field = np.where(outside | wall, distance, -distance)
    corners, triangles, _, _ = marching_cubes(field, _LEVEL * spacing, spacing=(spacing,) * 3)
    mesh = trimesh.Trimesh(corners + low - margin * spacing, triangles, process=False)
    shells = list(mesh.split(only_watertight=False))
    # The largest shell tells the orientation; shells turned the other way are hidden cavities.
    volumes = np.array([shell.volume for shell in shells])
    sign = np.sign(volumes[np.abs(volumes).argmax()])
    solid: Any = trimesh.util.concatenate(
        [s for s, v in zip(shells, volumes, strict=True) if v * sign > 0]
    )
    if sign < 0:
        solid.invert()
    return solid, spacing
