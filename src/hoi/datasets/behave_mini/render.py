"""Ray casting a scene to a photo: textures, one soft key light, one bounce of room light.

Visibility (what is drawn where) is decided at full resolution, so the masks are exact at pixel
centres. Light varies slowly and is sampled on a coarser grid (shadows every 2nd, bounces every
4th pixel), smoothed and carried back only between points of the same surface. open3d casts the
rays on one thread; the same scene gives the same bytes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numba
import numpy as np

from hoi.datasets.behave_mini.camera import Camera
from hoi.datasets.behave_mini.config import RenderConfig
from hoi.datasets.behave_mini.materials import Scene
from hoi.datasets.behave_mini.textures import SIZE
from hoi.datasets.behave_mini.wardrobe import Wardrobe

_BLOCK_ROWS = 192
_CREASE = np.cos(np.deg2rad(38.0))
_MIPS = 6
_LINEAR = ((np.arange(256) / 255) ** 2.2).astype(np.float32)
_ENCODE = (np.arange(4097) / 4096) ** (1 / 2.2)


class Hits(NamedTuple):
    """What each pixel of the full picture shows (H, W): -1 where nothing is hit.

    Args:
        triangle: (H, W) int32 index into all triangles of the scene.
        depth: (H, W) float32 metres along the optical axis, inf where nothing is hit.
        u, v: (H, W) float32 barycentric weights of the second and third corner.
    """

    triangle: np.ndarray
    depth: np.ndarray
    u: np.ndarray
    v: np.ndarray


class RayScene:
    """A scene prepared for casting: one flat list of triangles."""

    def __init__(self, scene: Scene):
        import open3d

        o3d: Any = open3d  # its stubs know no tensors made of arrays
        self._o3d = o3d
        self.scene = scene
        self._caster = o3d.t.geometry.RaycastingScene(nthreads=1)
        starts, corners, points, normals, materials, kinds = [0], [], [], [], [], []
        for index, surface in enumerate(scene.surfaces):
            vertices = np.ascontiguousarray(surface.vertices, np.float32)
            faces = np.ascontiguousarray(surface.faces, np.uint32)
            self._caster.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(faces))
            starts.append(starts[-1] + len(faces))
            corners.append(vertices[faces])
            points.append(surface.texture_points[surface.faces].astype(np.float32))
            normals.append(corner_normals(surface.vertices, surface.faces))
            materials.append(surface.face_materials)
            kinds.append(np.full(len(faces), index))
        self.starts = np.array(starts[:-1])
        self.corners = np.concatenate(corners)
        self.texture_corners = np.concatenate(points)
        self.corner_normals = np.concatenate(normals).astype(np.float32)
        self.materials = np.concatenate(materials).astype(np.int32)
        self.surface_of = np.concatenate(kinds).astype(np.int32)

    def first_hits(self, camera: Camera) -> Hits:
        """What the camera sees at every pixel centre."""
        shape = (camera.height, camera.width)
        triangle = np.empty(shape, np.int32)
        depth, u, v = (np.empty(shape, np.float32) for _ in range(3))
        for row in range(0, camera.height, _BLOCK_ROWS):
            rows = min(_BLOCK_ROWS, camera.height - row)
            block = np.s_[row : row + rows]
            rays = camera.rays(row, rows)
            triangle[block], depth[block], weights = self._cast(rays)
            u[block], v[block] = weights[..., 0], weights[..., 1]
        return Hits(triangle, depth, u, v)

    def hit(self, camera: Camera, first_row: int, rows: int) -> np.ndarray:
        """(rows, W) bool: the scene is seen at a pixel of these rows."""
        return self._cast(camera.rays(first_row, rows))[0] >= 0

    def surfaces_at(self, hits: Hits) -> np.ndarray:
        """(H, W) index of the surface seen, -1 for none."""
        seen = self.surface_of[np.maximum(hits.triangle, 0)]
        return np.where(hits.triangle >= 0, seen, -1)

    def _cast(self, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Triangle (-1: none), distance in units of the ray's direction, barycentric weights."""
        found = self._caster.cast_rays(self._o3d.core.Tensor(rays), nthreads=1)
        distance = found["t_hit"].numpy()
        hit = np.isfinite(distance)
        surface = np.where(hit, found["geometry_ids"].numpy(), 0).astype(np.int64)
        primitive = found["primitive_ids"].numpy().astype(np.int64)
        triangle = np.where(hit, self.starts[surface] + primitive, -1).astype(np.int32)
        return triangle, distance, found["primitive_uvs"].numpy()

    def occluded(self, origins: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(N,) bool: something lies between two points (N, 3)."""
        rays = np.concatenate([origins, targets - origins], axis=1).astype(np.float32)
        return self._caster.test_occlusions(
            self._o3d.core.Tensor(rays), tnear=0.0, tfar=0.999, nthreads=1
        ).numpy()

    def bounce(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Triangle hit (-1: none) and distance in metres from points along unit directions."""
        rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
        triangle, distance, _ = self._cast(rays)
        return triangle, distance


def corner_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3, 3) unit normal of each corner: smooth across flat edges, sharp across creases."""
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = area / (np.linalg.norm(area, axis=1, keepdims=True) + 1e-20)
    order = np.argsort(faces.ravel(), kind="stable")
    counts = np.bincount(faces.ravel(), minlength=len(vertices))
    # every pair of corners that share a vertex
    repeats = counts[faces.ravel()[order]]
    first = np.repeat(order, repeats)
    starts = (np.cumsum(counts) - counts)[faces.ravel()[order]]
    step = np.arange(len(first)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    second = order[np.repeat(starts, repeats) + step]
    alike = (unit[first // 3] * unit[second // 3]).sum(1) > _CREASE
    total = np.zeros((faces.size, 3))
    for axis in range(3):
        weights = area[second[alike] // 3, axis]
        total[:, axis] = np.bincount(first[alike], weights, minlength=faces.size)
    total /= np.linalg.norm(total, axis=1, keepdims=True) + 1e-20
    return total.reshape(-1, 3, 3)


def render(
    rays: RayScene,
    hits: Hits,
    camera: Camera,
    wardrobe: Wardrobe | None,
    config: RenderConfig,
    rng: np.random.Generator,
) -> np.ndarray:
    """The photo: (H, W, 3) uint8 sRGB."""
    scene = rays.scene
    points, normals = _interpolate(
        hits.triangle, hits.u, hits.v, rays.texture_corners, rays.corner_normals
    )
    materials = np.where(
        hits.triangle >= 0, rays.materials[np.maximum(hits.triangle, 0)], -1
    ).astype(np.int32)
    if wardrobe is not None:
        person = [i for i, s in enumerate(scene.surfaces) if s.kind == "person"]
        worn = np.isin(rays.surfaces_at(hits), person)
        materials[worn] = wardrobe.materials_at(points[worn].astype(np.float64))
    table = np.array([_material_row(m) for m in scene.materials], np.float32)
    atlas, offsets = _mipmapped(scene.textures)
    texture_normals = _face_normals(rays.texture_corners)
    view = camera.directions()
    pixel = 1.0 / float(camera.intrinsics[0, 0])
    albedo = _albedo(
        hits.triangle, hits.depth, points, normals, view, materials, table, texture_normals,
        atlas, offsets, pixel,
    )  # fmt: skip
    light = _lighting(rays, hits, normals, view, camera, table, config, rng)
    shaded = _shade(
        albedo, normals, view, hits.triangle, hits.depth, materials, table,
        camera.position.astype(np.float32), scene.light.astype(np.float32),
        scene.key.astype(np.float32), light,
    )  # fmt: skip
    return _develop(shaded, camera, config, rng)


def _material_row(m) -> tuple[float, ...]:
    return (*m.rgb, m.texture, m.tile, m.gloss, m.shine, m.folds, m.glow)


def _face_normals(corners: np.ndarray) -> np.ndarray:
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.abs(normals).argmax(1).astype(np.int32)


def _mipmapped(textures: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """All textures at all sizes in one array of linear colours, and where each size starts."""
    linear = [_LINEAR[t] for t in textures] or [np.ones((SIZE, SIZE, 3), "f4")]
    flat, offsets, start = [], np.zeros((len(linear), _MIPS), np.int64), 0
    for index, picture in enumerate(linear):
        for level in range(_MIPS):
            offsets[index, level] = start
            flat.append(picture.reshape(-1, 3))
            start += picture.shape[0] * picture.shape[1]
            half = (picture.shape[1] // 2, picture.shape[0] // 2)
            picture = cv2.resize(picture, half, interpolation=cv2.INTER_AREA)
    return np.concatenate(flat).astype(np.float32), offsets


@numba.njit(cache=True)
def _interpolate(triangle, u, v, texture_corners, corner_normals):
    """Texture-space point and unit normal of every pixel."""
    height, width = triangle.shape
    points = np.zeros((height, width, 3), np.float32)
    normals = np.zeros((height, width, 3), np.float32)
    for row in range(height):
        for column in range(width):
            t = triangle[row, column]
            if t < 0:
                continue
            b, c = u[row, column], v[row, column]
            a = 1.0 - b - c
            length = 0.0
            for k in range(3):
                points[row, column, k] = (
                    a * texture_corners[t, 0, k]
                    + b * texture_corners[t, 1, k]
                    + c * texture_corners[t, 2, k]
                )
                n = (
                    a * corner_normals[t, 0, k]
                    + b * corner_normals[t, 1, k]
                    + c * corner_normals[t, 2, k]
                )
                normals[row, column, k] = n
                length += n * n
            length = np.sqrt(length) + 1e-12
            for k in range(3):
                normals[row, column, k] /= length
    return points, normals


@numba.njit(cache=True)
def _sample(atlas, offset, size, s, t):
    """Bilinear colour of a texture level at (s, t) in repetitions."""
    x, y = (s - np.floor(s)) * size - 0.5, (1.0 - (t - np.floor(t))) * size - 0.5
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - x0, y - y0
    r, g, b = 0.0, 0.0, 0.0
    for dy in range(2):
        for dx in range(2):
            w = (fx if dx else 1 - fx) * (fy if dy else 1 - fy)
            i = offset + ((y0 + dy) % size) * size + (x0 + dx) % size
            r += w * atlas[i, 0]
            g += w * atlas[i, 1]
            b += w * atlas[i, 2]
    return r, g, b


@numba.njit(cache=True)
def _wave(x, y, z):
    """A smooth field without period in sight, for creases."""
    return np.sin(19 * x + 7 * np.sin(9 * y + 2 * z)) * np.cos(
        11 * y + 5 * np.sin(8 * z)
    ) + 0.5 * np.sin(41 * y + 23 * z + 3 * np.sin(31 * x))


@numba.njit(cache=True)
def _albedo(triangle, depth, points, normals, view, materials, table, axes, atlas, offsets, pixel):
    """Reflectance of every pixel; creases bend `normals` in place and normals face the viewer."""
    height, width = triangle.shape
    albedo = np.zeros((height, width, 3), np.float32)
    top = np.log2(SIZE)
    for row in range(height):
        for column in range(width):
            t = triangle[row, column]
            if t < 0:
                continue
            m = table[materials[row, column]]
            x, y, z = points[row, column, 0], points[row, column, 1], points[row, column, 2]
            if m[7] > 0:
                e, base = 0.004, _wave(x, y, z)
                normals[row, column, 0] -= m[7] * 0.018 * (_wave(x + e, y, z) - base) / e
                normals[row, column, 1] -= m[7] * 0.018 * (_wave(x, y + e, z) - base) / e
                normals[row, column, 2] -= m[7] * 0.018 * (_wave(x, y, z + e) - base) / e
            facing, length, ray = 0.0, 0.0, 0.0
            for k in range(3):
                facing += normals[row, column, k] * view[row, column, k]
                length += normals[row, column, k] ** 2
                ray += view[row, column, k] ** 2
            sign = -1.0 if facing > 0 else 1.0
            for k in range(3):
                normals[row, column, k] *= sign / np.sqrt(length)
            r, g, b = 1.0, 1.0, 1.0
            if m[3] >= 0:
                axis = axes[t]
                s, q = (z, y) if axis == 0 else ((x, z) if axis == 1 else (x, y))
                slant = max(abs(facing) / np.sqrt(length * ray), 0.12)
                texels = depth[row, column] * pixel / slant / m[4] * SIZE
                level = int(min(max(np.floor(np.log2(max(texels, 1.0)) + 0.3), 0), _MIPS - 1))
                size = int(2 ** (top - level))
                r, g, b = _sample(atlas, offsets[int(m[3]), level], size, s / m[4], q / m[4])
            albedo[row, column, 0] = r * m[0]
            albedo[row, column, 1] = g * m[1]
            albedo[row, column, 2] = b * m[2]
    return albedo


def _lighting(rays, hits, normals, view, camera, table, config, rng) -> np.ndarray:
    """(H, W, 4): share of the key light that arrives, and the colour of the room's light."""
    near = _grid(rays, hits, normals, view, camera, 2)
    lit = np.zeros(near.shape)
    for _ in range(config.shadow_rays):
        ball = _unit(rng, len(near.origins)) * rays.scene.light_radius
        lit[near.hit] += ~rays.occluded(near.origins, rays.scene.light + ball)
    lit /= config.shadow_rays
    far = _grid(rays, hits, normals, view, camera, 4)
    room = np.zeros((*far.shape, 3))
    mean = _mean_reflectance(rays, table)
    ceiling_glow = 0.55
    for _ in range(config.bounce_rays):
        direction = _unit(rng, len(far.origins)) + far.normals
        direction /= np.linalg.norm(direction, axis=1, keepdims=True) + 1e-9
        triangle, distance = rays.bounce(far.origins, direction)
        open_ = np.clip(distance / 0.9, 0.12, 1.0)[:, None]
        upward = ceiling_glow + 0.45 * np.clip(direction[:, 1:2], 0, 1)
        seen = np.where(triangle[:, None] >= 0, mean[np.maximum(triangle, 0)], 0.7)
        room[far.hit] += open_ * (0.45 * upward + 0.75 * seen * upward)
    room *= rays.scene.ambient / config.bounce_rays
    smooth_lit = _smooth(near, lit[..., None], 1)
    smooth_room = _smooth(far, room, 2)
    full = np.zeros((*hits.depth.shape, 4), np.float32)
    surface = rays.surfaces_at(hits).astype(np.int32)
    _upsample(smooth_lit, near.surface, near.plane_normals, surface, normals, 2, full[..., :1])
    _upsample(smooth_room, far.surface, far.plane_normals, surface, normals, 4, full[..., 1:])
    return full


class _Grid(NamedTuple):
    """Every n-th pixel: which hit anything, where they are, and what they belong to."""

    shape: tuple[int, int]
    hit: np.ndarray  # (h, w) bool
    origins: np.ndarray  # (N, 3) just above the surface
    normals: np.ndarray  # (N, 3)
    surface: np.ndarray  # (h, w) int32
    plane_normals: np.ndarray  # (h, w, 3)
    depth: np.ndarray  # (h, w)


def _grid(rays: RayScene, hits: Hits, normals, view, camera: Camera, step: int) -> _Grid:
    pick = np.s_[step // 2 :: step, step // 2 :: step]
    depth, triangle = hits.depth[pick], hits.triangle[pick]
    hit = triangle >= 0
    chosen = np.ascontiguousarray(normals[pick])
    places = camera.position + view[pick][hit] * depth[hit][:, None]
    origins = places + chosen[hit] * 2e-3
    surface = rays.surfaces_at(hits)[pick].astype(np.int32)
    return _Grid(depth.shape, hit, origins, chosen[hit].astype(np.float64), surface, chosen, depth)


def _unit(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) directions uniform on the sphere."""
    direction = rng.standard_normal((count, 3), dtype=np.float32).astype(np.float64)
    return direction / (np.linalg.norm(direction, axis=1, keepdims=True) + 1e-9)


def _mean_reflectance(rays: RayScene, table: np.ndarray) -> np.ndarray:
    """(T, 3) reflectance of every triangle without its texture's detail."""
    means = np.array([_LINEAR[t[::4, ::4]].mean((0, 1)) for t in rays.scene.textures])
    colour = table[:, :3].copy()
    textured = table[:, 3] >= 0
    colour[textured] *= means[table[textured, 3].astype(int)]
    return (colour + table[:, 8:9])[rays.materials]


def _smooth(grid: _Grid, values: np.ndarray, passes: int) -> np.ndarray:
    """Average over neighbours of the same surface and direction."""
    values = np.ascontiguousarray(values, np.float32)
    depth = np.where(np.isfinite(grid.depth), grid.depth, 0).astype(np.float32)
    for level in range(passes):
        values = _smooth_once(values, grid.surface, grid.plane_normals, depth, 2**level)
    return values


@numba.njit(cache=True)
def _smooth_once(values, surface, normals, depth, step):
    height, width, channels = values.shape
    result = np.zeros_like(values)
    for row in range(height):
        for column in range(width):
            own = surface[row, column]
            if own < 0:
                continue
            total = 0.0
            for dr in range(-2, 3):
                for dc in range(-2, 3):
                    r, c = row + dr * step, column + dc * step
                    if r < 0 or c < 0 or r >= height or c >= width or surface[r, c] != own:
                        continue
                    dot = 0.0
                    for k in range(3):
                        dot += normals[row, column, k] * normals[r, c, k]
                    if dot < 0.8 or abs(depth[r, c] - depth[row, column]) > 0.12:
                        continue
                    w = dot * dot * dot * dot / (1.0 + 0.3 * (dr * dr + dc * dc))
                    total += w
                    for k in range(channels):
                        result[row, column, k] += w * values[r, c, k]
            for k in range(channels):
                result[row, column, k] /= max(total, 1e-9)
    return result


@numba.njit(cache=True)
def _upsample(values, coarse_surface, coarse_normals, surface, normals, step, result):
    """Bilinear into `result`, but only from points of the same surface that face the same way.

    Where the four nearest points are all of other surfaces, the search widens to sixteen, and in
    the end takes whatever is near.
    """
    height, width = surface.shape
    rows, columns, channels = values.shape
    half = step // 2
    for row in range(height):
        for column in range(width):
            own = surface[row, column]
            if own < 0:
                continue
            y, x = (row - half) / step, (column - half) / step
            y0, x0 = int(np.floor(y)), int(np.floor(x))
            total = 0.0
            for reach in range(2):
                for dy in range(-reach, 2 + reach):
                    for dx in range(-reach, 2 + reach):
                        r = min(max(y0 + dy, 0), rows - 1)
                        c = min(max(x0 + dx, 0), columns - 1)
                        if coarse_surface[r, c] != own:
                            continue
                        away = (1.0 + reach - abs(y0 + dy - y)) * (1.0 + reach - abs(x0 + dx - x))
                        dot = 0.0
                        for k in range(3):
                            dot += normals[row, column, k] * coarse_normals[r, c, k]
                        w = max(away, 0.0) * max(dot, 0.02) ** 4 + 1e-9
                        total += w
                        for k in range(channels):
                            result[row, column, k] += w * values[r, c, k]
                if total > 1e-3:
                    break
            if total == 0.0:
                r, c = min(max(y0, 0), rows - 1), min(max(x0, 0), columns - 1)
                total = 1.0
                for k in range(channels):
                    result[row, column, k] = values[r, c, k]
            for k in range(channels):
                result[row, column, k] /= total


@numba.njit(cache=True)
def _shade(albedo, normals, view, triangle, depth, materials, table, eye, lamp, key, light):
    """Radiance of every pixel: key light with a highlight, room light, and what glows."""
    height, width = triangle.shape
    result = np.zeros((height, width, 3), np.float32)
    to_lamp, half = np.zeros(3, np.float32), np.zeros(3, np.float32)
    for row in range(height):
        for column in range(width):
            if triangle[row, column] < 0:
                continue
            m = table[materials[row, column]]
            z = depth[row, column]
            distance, ray = 0.0, 0.0
            for k in range(3):
                to_lamp[k] = lamp[k] - (eye[k] + view[row, column, k] * z)
                distance += to_lamp[k] ** 2
                ray += view[row, column, k] ** 2
            lambert, length = 0.0, 0.0
            for k in range(3):
                to_lamp[k] /= np.sqrt(distance)
                lambert += to_lamp[k] * normals[row, column, k]
                half[k] = to_lamp[k] - view[row, column, k] / np.sqrt(ray)
                length += half[k] ** 2
            arriving = light[row, column, 0] * 4.0 / (distance + 1.0)
            spread = max(lambert, 0.0)
            shine = 0.0
            if m[5] > 0 and lambert > 0:
                for k in range(3):
                    shine += half[k] * normals[row, column, k] / np.sqrt(length)
                shine = m[5] * max(shine, 0.0) ** m[6] * 0.6
            for k in range(3):
                a = albedo[row, column, k]
                result[row, column, k] = (
                    a * (light[row, column, 1 + k] + key[k] * arriving * spread + m[8])
                    + key[k] * arriving * shine
                )
    return result


def _develop(
    radiance: np.ndarray, camera: Camera, config: RenderConfig, rng: np.random.Generator
) -> np.ndarray:
    """Exposure, lens blur, sensor noise and tone curve of a consumer camera."""
    level = np.percentile(radiance[::8, ::8].mean(-1), 80)
    gain = rng.uniform(0.5, 0.72) / max(float(level), 1e-3) * rng.uniform(0.94, 1.06, 3)
    centre, focal = camera.intrinsics[:2, 2], camera.intrinsics[0, 0]
    across = ((np.arange(camera.width) - centre[0]) / focal) ** 2
    down = ((np.arange(camera.height) - centre[1]) / focal) ** 2
    falloff = 1.0 - 0.12 * np.minimum(across + down[:, None], 1.5)
    exposed = radiance * gain.astype(np.float32)
    exposed *= falloff[..., None].astype(np.float32)
    sigma = config.blur_px * camera.width / 2048
    if sigma > 0.15:
        exposed = cv2.GaussianBlur(exposed, (0, 0), sigma)
    exposed *= (1 + exposed / 6.0) / (1 + exposed / 1.35)  # soft shoulder
    np.clip(exposed, 0, 1, out=exposed)
    curve = (_ENCODE.astype(np.float32) * 255)[(exposed * 4096).astype(np.int32)]
    noise = rng.standard_normal(exposed.shape, dtype=np.float32)
    curve += noise * (1.3 - exposed) * np.float32(config.noise * 255)
    return np.clip(curve + 0.5, 0, 255).astype(np.uint8)
