"""What the PHOSA baseline (Zhang et al., ECCV 2020) needs besides its loss terms.

PHOSA fixes by hand, per object category, which body parts touch which object parts, whatever the
person does. Its published categories do not include ours, so these rules are this project's: the
contact of the category's typical use. It is given the calibrated camera, the size prior and the
exemplars of the other methods, so that only the method differs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np
import torch
from torch import Tensor

from hoi.geometry import project
from hoi.joint.config import JointConfig, Phosa
from hoi.joint.inputs import Inputs
from hoi.rendering import crop_mask, depth_map, intrinsics_for

if TYPE_CHECKING:
    from hoi.joint.problem import BodyRegions

_SEAT = (("chair_seat", ("butt",)), ("chair_back", ("back",)))
_BY_HAND = (("left_hand",), ("right_hand",))

#: Category -> (object part, body regions whose vertices make one centroid).
PART_PAIRS: dict[str, tuple[tuple[str, tuple[str, ...]], ...]] = {
    "chair": _SEAT,
    "couch": _SEAT,
    "stool": _SEAT[:1],
    "table": tuple(("tabletop", hand) for hand in _BY_HAND),
    "desk": tuple(("tabletop", hand) for hand in _BY_HAND),
    "keyboard": tuple(("key", hand) for hand in _BY_HAND),
    "backpack": (("bag_body", ("back",)),),
    "suitcase": tuple(("handle", hand) for hand in _BY_HAND),
}


@dataclass(frozen=True)
class PhosaPart:
    """One hand-made part pair: the object part and the body part at scale 1."""

    object_part: str
    centroid: Tensor  # (3,) metres
    box: Tensor  # (4,) x0, y0, x1, y1 pixels of the photo
    depth: Tensor  # (2,) nearest, farthest, metres


@dataclass(frozen=True)
class PhosaScene:
    """Constants of the baseline for one frame.

    Attributes:
        whole: the whole body as a part; parts: the category's part pairs.
        intrinsics: (3, 3) of the photo. ordinal: constants of the ordinal depth term.
        expansion, depth_gap: of the interaction gate.
    """

    whole: PhosaPart
    parts: tuple[PhosaPart, ...]
    intrinsics: np.ndarray
    ordinal: OrdinalScene
    expansion: float
    depth_gap: float


@dataclass(frozen=True)
class OrdinalScene:
    """Who is in front where, by the masks, and where the body's surface is.

    Attributes:
        intrinsics: (3, 3) of the region at the resolution of the maps, all (H, W).
        body_depth: depth of the body at scale 1, infinity where it is not. It scales with s_h,
            because scaling about the camera centre moves no pixel.
        object_front, body_front: what the masks show.
        pixel_weight: how many pixels of PHOSA's image one pixel of the maps stands for.
        clamp: metres.
    """

    intrinsics: np.ndarray
    body_depth: Tensor
    object_front: Tensor
    body_front: Tensor
    pixel_weight: float
    clamp: float


def phosa_scene(config: JointConfig, inputs: Inputs, regions: BodyRegions) -> PhosaScene | None:
    """The baseline's constants; None when the method lists none of its terms."""
    if not any(name.startswith("phosa_") for name in config.terms):
        return None
    body, intrinsics = inputs.body_vertices, inputs.intrinsics

    def part(object_part: str, points: np.ndarray) -> PhosaPart:
        pixels = project(points, intrinsics)
        return PhosaPart(
            object_part,
            torch.from_numpy(points.mean(0)).float(),
            torch.from_numpy(np.concatenate([pixels.min(0), pixels.max(0)])).float(),
            torch.tensor([float(points[:, 2].min()), float(points[:, 2].max())]),
        )

    return PhosaScene(
        whole=part("", body),
        parts=tuple(
            part(object_part, body[_union(regions, names)])
            for object_part, names in PART_PAIRS.get(inputs.category, ())
        ),
        intrinsics=intrinsics,
        ordinal=_ordinal_scene(config.phosa, inputs, regions.faces),
        expansion=config.phosa.box_expansion,
        depth_gap=config.phosa.depth_gap,
    )


def _ordinal_scene(settings: Phosa, inputs: Inputs, body_faces: np.ndarray) -> OrdinalScene:
    roi, resolution = inputs.roi, settings.depth_resolution
    intrinsics = intrinsics_for(roi, inputs.intrinsics, resolution)
    depth = depth_map(inputs.body_vertices, body_faces, intrinsics, resolution, resolution)
    thing = crop_mask(inputs.object_mask, roi, resolution) > 0.5
    person = crop_mask(inputs.person_mask, roi, resolution) > 0.5
    cell = roi.side / resolution * settings.image_size / max(inputs.object_mask.shape)
    return OrdinalScene(
        intrinsics=intrinsics,
        body_depth=torch.from_numpy(depth),
        object_front=torch.from_numpy(thing & ~person),
        body_front=torch.from_numpy(person & ~thing),
        pixel_weight=cell**2,
        clamp=settings.depth_clamp,
    )


def _union(regions: BodyRegions, names: tuple[str, ...]) -> np.ndarray:
    return np.unique(np.concatenate([regions.vertices[name] for name in names]))


def order_violations(
    vertices: Tensor, faces: Sequence[np.ndarray], human_scale: Tensor, scene: OrdinalScene
) -> tuple[Tensor, Tensor]:
    """How far each hypothesis violates the masks' occlusion order, at every pixel where it does.

    Which face is seen at a pixel is taken as fixed; its depth is differentiated exactly, as that of
    its plane along the pixel's ray.

    Args:
        vertices: (K, V, 3) placed objects, camera frame. faces: K arrays (F, 3).
        human_scale: (K,) of the body.

    Returns:
        (N,) positive metres, and (N,) the hypothesis of each, N the number of violating pixels.
    """
    front = scene.object_front.numpy().astype(np.int8) - scene.body_front.numpy()
    scales, body_depth = human_scale.detach().numpy(), scene.body_depth.numpy()
    found = []
    for k, mesh in enumerate(faces):
        seen, depth = visible_faces(
            vertices[k].detach().numpy(), mesh, scene.intrinsics, *body_depth.shape
        )
        pixels = _violating(depth, body_depth, scales[k], front)
        row, column = pixels // depth.shape[1], pixels % depth.shape[1]
        found.append((np.full(len(pixels), k), mesh[seen[row, column]], row, column))
    hypothesis, corner_index, row, column = (
        np.concatenate(part) for part in zip(*found, strict=True)
    )
    which = torch.from_numpy(hypothesis)
    corners = vertices[which[:, None], torch.from_numpy(corner_index)]  # (N, 3, 3)
    ray = torch.from_numpy(_rays(row, column, scene.intrinsics)).to(vertices)
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    object_depth = (normal * corners[:, 0]).sum(-1) / (normal * ray).sum(-1)
    body = torch.from_numpy(body_depth[row, column]).to(vertices) * human_scale[which]
    sign = torch.from_numpy(front[row, column]).to(vertices)
    return sign * (object_depth - body), which


def _rays(row: np.ndarray, column: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Directions (N, 3) with z = 1 through pixel centres."""
    x = (column + 0.5 - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (row + 0.5 - intrinsics[1, 2]) / intrinsics[1, 1]
    return np.stack([x, y, np.ones_like(x)], -1)


@numba.njit(cache=True, nogil=True)
def _violating(object_depth, body_depth, human_scale, front):
    """Flat indices of pixels whose order contradicts `front` (1 object, -1 body, 0 unknown)."""
    height, width = object_depth.shape
    found = np.empty(height * width, np.int64)
    count = 0
    for row in range(height):
        for column in range(width):
            thing, body = object_depth[row, column], body_depth[row, column] * human_scale
            if np.isfinite(thing) and np.isfinite(body) and front[row, column] * (thing - body) > 0:
                found[count] = row * width + column
                count += 1
    return found[:count]


def visible_faces(
    vertices: np.ndarray, faces: np.ndarray, intrinsics: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """The nearest face at each pixel centre: index (H, W), -1 for none, and its depth (H, W).

    Faces that reach behind the camera are left out.
    """
    index = np.full((height, width), -1, np.int64)
    depth = np.full((height, width), np.inf, np.float32)
    z = np.ascontiguousarray(vertices[:, 2], np.float64)
    safe = np.where(z > 1e-2, z, np.nan)
    x = vertices[:, 0] / safe * intrinsics[0, 0] + intrinsics[0, 2]
    y = vertices[:, 1] / safe * intrinsics[1, 1] + intrinsics[1, 2]
    _face_buffer(x.astype(np.float64), y.astype(np.float64), safe, faces, index, depth)
    return index, depth


@numba.njit(cache=True, nogil=True)
def _face_buffer(x, y, z, faces, index, depth):
    height, width = depth.shape
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        area = (x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a])
        if not abs(area) > 1e-12:  # also leaves out NaN
            continue
        first_row = max(int(np.ceil(min(y[a], y[b], y[c]) - 0.5)), 0)
        last_row = min(int(np.floor(max(y[a], y[b], y[c]) - 0.5)), height - 1)
        first_column = max(int(np.ceil(min(x[a], x[b], x[c]) - 0.5)), 0)
        last_column = min(int(np.floor(max(x[a], x[b], x[c]) - 0.5)), width - 1)
        for row in range(first_row, last_row + 1):
            v = row + 0.5
            for column in range(first_column, last_column + 1):
                u = column + 0.5
                wb = ((u - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (v - y[a])) / area
                wc = ((x[b] - x[a]) * (v - y[a]) - (u - x[a]) * (y[b] - y[a])) / area
                wa = 1.0 - wb - wc
                if wa < 0 or wb < 0 or wc < 0:
                    continue
                here = np.float32(1.0 / (wa / z[a] + wb / z[b] + wc / z[c]))
                if here < depth[row, column]:
                    depth[row, column] = here
                    index[row, column] = f
