"""Shaded pictures of triangle meshes by ray casting on the CPU: no window, no GL, no chance.

The same meshes and rays give the same picture on every run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

HEADLIGHT_UP = 0.45  # how far the light stands above the viewer, against its distance
AMBIENT = 0.38


@dataclass(frozen=True)
class Surface:
    """A coloured mesh to draw.

    Attributes:
        vertices: (V, 3) metres.
        faces: (F, 3) indices.
        colours: (3,) or (V, 3) sRGB in 0..255.
        smooth: shade by interpolated vertex normals (skin) or by face normals (furniture).
    """

    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray
    smooth: bool = False


@dataclass(frozen=True)
class Shot:
    """What the rays met: colour (H, W, 3) 0..255, coverage (H, W) 0..1 after antialiasing."""

    colour: np.ndarray
    coverage: np.ndarray


@dataclass(frozen=True)
class Rays:
    """Rays of one picture: origins and unit directions (H, W, 3), and the picture's up (3,)."""

    origins: np.ndarray
    directions: np.ndarray
    up: np.ndarray


def camera_rays(
    intrinsics: np.ndarray, crop: tuple[float, float, float, float], width: int, height: int
) -> Rays:
    """Rays of a pinhole camera at the origin through a picture of a crop of its image.

    Args:
        intrinsics: (3, 3) K in pixels.
        crop: x0, y0, x1, y1 in pixels of the full image.
        width, height: size of the picture that shows the crop.
    """
    x0, y0, x1, y1 = crop
    columns = x0 + (np.arange(width) + 0.5) * (x1 - x0) / width
    rows = y0 + (np.arange(height) + 0.5) * (y1 - y0) / height
    x = (columns - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (rows - intrinsics[1, 2]) / intrinsics[1, 1]
    directions = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones((height, width))])
    directions = np.moveaxis(directions, 0, -1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return Rays(np.zeros_like(directions), directions, np.array([0.0, -1.0, 0.0]))


def orthographic_rays(
    centre: np.ndarray,
    right: np.ndarray,
    up: np.ndarray,
    span: tuple[float, float],
    width: int,
    height: int,
) -> Rays:
    """Parallel rays of a picture `span` metres wide and high about `centre`.

    `right` and `up` (3,) are unit vectors of the picture's axes; the view goes along up x right.
    """
    forward = np.cross(up, right)
    across = ((np.arange(width) + 0.5) / width - 0.5) * span[0]
    upward = (0.5 - (np.arange(height) + 0.5) / height) * span[1]
    origins = centre + across[None, :, None] * right + upward[:, None, None] * up - 100.0 * forward
    return Rays(origins, np.broadcast_to(forward, origins.shape), np.asarray(up, float))


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals (V, 3) of vertices; zero where a vertex has no face."""
    corners = vertices[faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    index = faces.ravel()
    spread = np.repeat(weighted, 3, axis=0)
    total = np.stack(
        [np.bincount(index, spread[:, axis], minlength=len(vertices)) for axis in range(3)], axis=1
    )
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def shoot(surfaces: list[Surface], rays: Rays, supersampling: int = 1) -> Shot:
    """Cast the rays against the surfaces; the nearest hit wins.

    Args:
        surfaces: meshes in the frame of the rays; may be empty.
        rays: of a picture `supersampling` times larger than the result on each side.
        supersampling: rays a pixel side that are averaged.
    """
    height, width = rays.directions.shape[:2]
    colour, hit = np.zeros((height, width, 3)), np.zeros((height, width), bool)
    surfaces = [surface for surface in surfaces if len(surface.faces)]
    if surfaces:
        colour, hit = _nearest(surfaces, rays)
    return _average(colour, hit, supersampling)


def distance_to_surface(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance in metres (N,) of points (N, 3) from the nearest point of a mesh's surface."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(_tensor(vertices, np.float32), _tensor(faces, np.uint32))
    return scene.compute_distance(_tensor(points, np.float32), nthreads=1).numpy()


def _tensor(array: np.ndarray, dtype: type):
    import open3d as o3d

    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array, dtype=dtype))


def _nearest(surfaces: list[Surface], rays: Rays) -> tuple[np.ndarray, np.ndarray]:
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    for surface in surfaces:
        scene.add_triangles(
            _tensor(surface.vertices, np.float32), _tensor(surface.faces, np.uint32)
        )
    packed = np.concatenate([rays.origins, rays.directions], axis=-1)
    answer = scene.cast_rays(_tensor(packed, np.float32), nthreads=1)
    hit = np.isfinite(answer["t_hit"].numpy())
    identity = answer["geometry_ids"].numpy()
    triangle = answer["primitive_ids"].numpy()
    uv = answer["primitive_uvs"].numpy()
    flat = answer["primitive_normals"].numpy()

    colour = np.zeros((*hit.shape, 3))
    light = HEADLIGHT_UP * rays.up - rays.directions
    light /= np.linalg.norm(light, axis=-1, keepdims=True)
    for number, surface in enumerate(surfaces):
        here = hit & (identity == number)
        corners = surface.faces[triangle[here]]
        weights = np.column_stack([1.0 - uv[here].sum(axis=1), uv[here]])
        normals = flat[here]
        if surface.smooth:
            own = vertex_normals(surface.vertices, surface.faces)
            normals = np.einsum("nk,nkc->nc", weights, own[corners])
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        base = np.asarray(surface.colours, float)
        if base.ndim == 2:
            base = np.einsum("nk,nkc->nc", weights, base[corners])
        # Winding differs between sources of meshes, so both sides are lit alike.
        lambert = np.abs(np.einsum("nc,nc->n", normals, light[here]))
        colour[here] = base * (AMBIENT + (1.0 - AMBIENT) * lambert)[:, None]
    return colour, hit


def _average(colour: np.ndarray, hit: np.ndarray, factor: int) -> Shot:
    height, width = hit.shape[0] // factor, hit.shape[1] // factor
    blocks = (height, factor, width, factor)
    count = hit.reshape(blocks).sum(axis=(1, 3))
    total = (colour * hit[..., None]).reshape(*blocks, 3).sum(axis=(1, 3))
    return Shot(total / np.maximum(count, 1)[..., None], count / factor**2)
