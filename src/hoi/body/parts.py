"""Named regions of the body surface, found from a template's shape, weights and joints alone.

The rules use anatomy (which joint owns a vertex, which way its skin faces, where it lies between
joints) and lengths scaled by stature, never vertex numbers, so they hold for the embedded body
and for a user's SMPL.
"""

from __future__ import annotations

import numpy as np

from hoi.body.model import BodyModel
from hoi.body.skeleton import JOINT

#: Every region that :func:`part_vertices` returns.
REGIONS: tuple[str, ...] = (
    *("head", "neck", "torso", "back", "butt", "chest", "belly", "waist", "shoulders", "lap"),
    *("left_hand", "right_hand", "left_foot", "right_foot", "left_leg", "right_leg"),
    *("left_forearm", "right_forearm", "left_thigh", "right_thigh", "left_arm", "right_arm"),
    *("mouth", "body"),
)


def part_vertices(model: BodyModel) -> dict[str, np.ndarray]:
    """Vertex indices (sorted int64) of every region in :data:`REGIONS`.

    `butt` reaches over the back of the upper thighs, which is what a seat touches; `shoulders` are
    their upward-facing tops, where straps lie; `lap` is the front of the thighs. Regions overlap.
    """
    masks = region_masks(model.v_template, model.faces, model.weights, model.template_joints)
    return {name: np.flatnonzero(masks[name]) for name in REGIONS}


def region_masks(
    vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, joints: np.ndarray
) -> dict[str, np.ndarray]:
    """Boolean masks (V,) of every region, on a T-posed template (y up, +z front, +x left)."""
    scale = np.ptp(vertices[:, 1]) / 1.7
    normals = vertex_normals(vertices, faces)
    owner = weights.argmax(1)

    def owned_by(*names: str) -> np.ndarray:
        return np.isin(owner, [JOINT[name] for name in names])

    masks = _limbs(owned_by)
    masks |= {"head": owned_by("head"), "neck": owned_by("neck")}
    masks |= _trunk(vertices, normals, joints, scale, owned_by)
    masks["shoulders"] = _shoulder_tops(vertices, normals, joints, scale, owned_by)
    masks["mouth"] = _mouth(vertices, normals, scale, masks["head"])
    masks["body"] = np.ones(len(vertices), dtype=bool)
    return masks


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals (V, 3)."""
    corners = vertices[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], face_normals)
    return normals / (np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12)


def _limbs(owned_by) -> dict[str, np.ndarray]:
    masks = {}
    for side in ("left", "right"):
        masks[f"{side}_hand"] = owned_by(f"{side}_wrist", f"{side}_hand")
        masks[f"{side}_foot"] = owned_by(f"{side}_ankle", f"{side}_foot")
        masks[f"{side}_thigh"] = owned_by(f"{side}_hip")
        masks[f"{side}_leg"] = owned_by(f"{side}_hip", f"{side}_knee") | masks[f"{side}_foot"]
        masks[f"{side}_forearm"] = owned_by(f"{side}_elbow")
        masks[f"{side}_arm"] = owned_by(f"{side}_shoulder", f"{side}_elbow")
    return masks


def _trunk(vertices, normals, joints, scale, owned_by) -> dict[str, np.ndarray]:
    _, y, z = vertices.T
    facing_up, facing_front = normals[:, 1], normals[:, 2]
    hip = (joints[JOINT["left_hip"]] + joints[JOINT["right_hip"]]) / 2
    pelvis_y, spine2_y = joints[JOINT["pelvis"], 1], joints[JOINT["spine2"], 1]
    spine = ("pelvis", "spine1", "spine2", "spine3")
    torso = owned_by(*spine, "left_collar", "right_collar")
    thighs = owned_by("left_hip", "right_hip")
    butt = (
        (owned_by("pelvis") | thighs)
        & ((facing_front < -0.15) | (facing_up < -0.5))
        & (z < hip[2])
        & (y > hip[1] - 0.13 * scale)
        & (y < pelvis_y + 0.10 * scale)
    )
    return {
        "torso": torso,
        "butt": butt,
        "back": torso
        & ~butt
        & (facing_front < -0.15)
        & (z < joints[JOINT["spine3"], 2] + 0.02 * scale)
        & (y > pelvis_y + 0.05 * scale),
        "chest": owned_by("spine2", "spine3", "left_collar", "right_collar")
        & (facing_front > 0.2)
        & (y > spine2_y),
        "belly": owned_by("pelvis", "spine1", "spine2")
        & (facing_front > 0.2)
        & (y > pelvis_y - 0.03 * scale),
        "waist": torso
        & (y > joints[JOINT["spine1"], 1] - 0.06 * scale)
        & (y < spine2_y + 0.02 * scale),
        "lap": thighs & (facing_front > 0.1) & (y < hip[1] - 0.02 * scale),
    }


def _shoulder_tops(vertices, normals, joints, scale, owned_by) -> np.ndarray:
    left, right = joints[JOINT["left_shoulder"]], joints[JOINT["right_shoulder"]]
    x, y, _ = vertices.T
    around = owned_by(
        *("spine3", "neck", "left_collar", "right_collar", "left_shoulder", "right_shoulder")
    )
    top = around & (normals[:, 1] > 0.25) & (y > (left[1] + right[1]) / 2 - 0.02 * scale)
    beside_neck = np.abs(x) > 0.05 * scale
    return top & beside_neck & (x < left[0] + 0.07 * scale) & (x > right[0] - 0.07 * scale)


def _mouth(vertices, normals, scale, head) -> np.ndarray:
    x, y, z = vertices.T
    profile = np.flatnonzero(head & (np.abs(x) < 0.012 * scale))
    nose = vertices[profile[np.argmax(z[profile])]]
    return (
        head
        & (np.abs(x) < 0.032 * scale)
        & (y < nose[1] - 0.018 * scale)
        & (y > nose[1] - 0.055 * scale)
        & (z > nose[2] - 0.055 * scale)
        & (normals[:, 2] > 0.1)
    )
