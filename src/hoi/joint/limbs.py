"""Let the touching limbs move: the last step, after body and object have been placed together.

The body was fitted without knowing of the object, so that a hand may end some centimetres before
the chair it holds, mostly in depth, which the picture does not show. Only the joints of the limbs
that touch are free; the keypoints of these limbs and their fitted pose hold them. Not in the paper;
after PICO's last phase (Cseke et al., 2025).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from hoi.artifacts import BodyFit
from hoi.body import BodyModel
from hoi.body.keypoints import KEYPOINT
from hoi.body.skeleton import JOINT
from hoi.exemplars import Exemplar
from hoi.geometry import project, sample_surface
from hoi.joint.config import LimbSettings
from hoi.joint.contacts import ContactPair

#: Region that touches -> the joints that move it.
CHAINS: dict[str, tuple[str, ...]] = {
    f"{side}_{end}": tuple(f"{side}_{joint}" for joint in joints)
    for side in ("left", "right")
    for end, joints in (
        ("hand", ("collar", "shoulder", "elbow", "wrist")),
        ("foot", ("hip", "knee", "ankle")),
    )
}
_OF_LIMB = {
    "hand": ("shoulder", "elbow", "wrist"),
    "foot": ("hip", "knee", "ankle", "toe", "heel"),
}

_TARGET_POINTS = 800  # on the parts that a limb may touch


@dataclass(frozen=True)
class LimbTarget:
    """A region that touches, and where: `points` (N, 3) on the placed object, camera frame."""

    region: str
    points: np.ndarray


@dataclass(frozen=True)
class Refined:
    """The body with moved limbs: parameters, vertices (V, 3), joints (24, 3); metres.

    `before`, `after`: metres from the touching share of the region to the object, per target.
    """

    body_pose: np.ndarray
    vertices: np.ndarray
    joints: np.ndarray
    before: dict[str, float]
    after: dict[str, float]


def limb_targets(
    pairs: Sequence[ContactPair],
    exemplar: Exemplar,
    object_vertices: np.ndarray,
    body_vertices: np.ndarray,
    regions: dict[str, np.ndarray],
    seed: int,
) -> list[LimbTarget]:
    """Every hand and foot that touches, with points on the parts it may touch.

    Of alternatives (either hand) the nearest one touches.
    """
    parts: dict[str, set[str]] = {}
    alternative: dict[str, int] = {}
    for pair in pairs:
        for region in pair.body_parts:
            if region in CHAINS and region in regions:
                parts.setdefault(region, set()).update(pair.object_parts)
                alternative[region] = pair.alternative
    targets, distance = {}, {}
    for region, names in parts.items():
        allowed = [i for i, name in enumerate(exemplar.part_names) if name in names]
        faces = exemplar.faces[np.isin(exemplar.face_parts, allowed)]
        if len(faces):
            rng = np.random.default_rng(seed)
            targets[region] = LimbTarget(
                region, sample_surface(object_vertices, faces, _TARGET_POINTS, rng)
            )
            own = body_vertices[regions[region]]
            distance[region] = float(KDTree(targets[region].points).query(own)[0].min())
    nearest = {
        number: min((r for r in targets if alternative[r] == number), key=distance.__getitem__)
        for number in {alternative[r] for r in targets} - {-1}
    }
    return [
        target
        for region, target in targets.items()
        if alternative[region] == -1 or nearest[alternative[region]] == region
    ]


def refine_limbs(
    model: BodyModel,
    regions: dict[str, np.ndarray],
    body: BodyFit,
    keypoints: np.ndarray,
    intrinsics: np.ndarray,
    targets: Sequence[LimbTarget],
    settings: LimbSettings,
) -> Refined | None:
    """Move the limbs of the targets within reach; None when none is.

    Minimises, over the joint rotations of these limbs, the mean squared distance of the nearest
    share of the region's vertices to the object, squared reprojection errors of the limbs'
    keypoints (weighted by confidence) and squared changes of the rotations, each in units of its
    standard deviation in `settings`.

    Args:
        regions: region -> vertex indices. keypoints: (21, 3) x, y, confidence, pixels.
        intrinsics: (3, 3) pixels.
    """
    assert body.vertices is not None and body.body_pose is not None
    targets = [t for t in targets if t.region in CHAINS and t.region in regions]
    gaps = {t.region: _gap(body.vertices[regions[t.region]], t.points, settings) for t in targets}
    targets = [t for t in targets if settings.done < gaps[t.region] < settings.reach]
    if not targets:
        return None
    parameters = [
        torch.tensor(np.asarray(value)[None], dtype=torch.float32)
        for value in (body.global_orient, body.body_pose, body.betas, body.transl)
    ]
    orient, pose, betas, transl = parameters
    free = torch.zeros(69, dtype=torch.bool)
    for target in targets:
        for joint in CHAINS[target.region]:
            start = 3 * (JOINT[joint] - 1)
            free[start : start + 3] = True
    seen = torch.from_numpy(np.asarray(keypoints, np.float32))
    held = torch.tensor(sorted({k for t in targets for k in _keypoints_of(t.region)}))
    goals = [torch.from_numpy(np.asarray(t.points, np.float32)) for t in targets]
    rows = [torch.from_numpy(np.asarray(regions[t.region])) for t in targets]
    pixel_sd = settings.keypoint_share * _height(body.vertices, intrinsics)
    change = torch.zeros(int(free.sum()), requires_grad=True)

    def posed() -> Tensor:
        moved = torch.zeros_like(pose)
        moved[0, free] = change
        return pose + moved

    def energy() -> Tensor:
        current = posed()
        vertices = model(orient, current, betas, transl).vertices[0]
        total = (change / np.radians(settings.pose_deg)).square().sum()
        for goal, region in zip(goals, rows, strict=True):
            nearest = torch.cdist(vertices[region], goal).amin(1)
            count = max(1, int(settings.touching_share * len(region)))
            touching = nearest.topk(count, largest=False).values
            total = total + (touching / settings.contact_m).square().mean()
        points = project(model.keypoints(orient, current, betas, transl)[0], intrinsics)
        off = (points - seen[:, :2])[held].square().sum(-1) / pixel_sd**2
        return total + (seen[held, 2] * off).sum()

    optimiser = torch.optim.LBFGS(
        [change], max_iter=settings.iterations, line_search_fn="strong_wolfe"
    )

    def closure() -> Tensor:
        optimiser.zero_grad()
        value = energy()
        value.backward()
        return value

    optimiser.step(closure)
    with torch.no_grad():
        if not bool(torch.isfinite(change).all()):
            return None
        final = posed()
        moved = model(orient, final, betas, transl)
        vertices = moved.vertices[0].numpy()
        joints = moved.joints[0].numpy()
    return Refined(
        body_pose=final[0].double().numpy(),
        vertices=vertices,
        joints=joints,
        before={t.region: gaps[t.region] for t in targets},
        after={t.region: _gap(vertices[regions[t.region]], t.points, settings) for t in targets},
    )


def _keypoints_of(region: str) -> list[int]:
    side, end = region.split("_")
    return [KEYPOINT[f"{side}_{name}"] for name in _OF_LIMB[end]]


def _gap(region: np.ndarray, points: np.ndarray, settings: LimbSettings) -> float:
    """Root mean square distance of the nearest share of the region (N, 3) to the points (M, 3)."""
    nearest = np.sort(np.sqrt(((region[:, None] - points[None]) ** 2).sum(-1)).min(1))
    count = max(1, int(settings.touching_share * len(nearest)))
    return float(np.sqrt((nearest[:count] ** 2).mean()))


def _height(vertices: np.ndarray, intrinsics: np.ndarray) -> float:
    """Pixels that the body spans."""
    return float(np.ptp(project(vertices, intrinsics), axis=0).max())
