"""Refinement of the touching limbs: an arm that reaches for a wall it does not quite touch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hoi.artifacts import BodyFit
from hoi.geometry import project
from hoi.joint.config import JointConfig, LimbSettings
from hoi.joint.limbs import LimbTarget, refine_limbs
from joint_scene import INTRINSICS, body_model, body_regions

LEVEL = np.array([np.pi, 0, 0])  # upright before a level camera
SETTINGS = LimbSettings(pose_deg=10.0)


def standing(pose: np.ndarray | None = None) -> BodyFit:
    """A standing body with its arms forward, 3 m away."""
    model = body_model()
    names = list(model.joint_names)
    rotations = np.zeros((23, 3))
    for side, sign in (("left", 1), ("right", -1)):
        rotations[names.index(f"{side}_shoulder") - 1] = [0, -0.8 * sign, -0.6 * sign]
        rotations[names.index(f"{side}_elbow") - 1] = [0, -1.2 * sign, 0]
    pose = rotations.reshape(69) if pose is None else pose
    betas, transl = np.zeros(model.num_betas), np.array([0.0, 0.2, 3.0])
    values = [torch.tensor(v[None], dtype=torch.float32) for v in (LEVEL, pose, betas, transl)]
    with torch.no_grad():
        out = model(*values)
    return BodyFit(
        frame_id="toy", body_model=model.identity, global_orient=LEVEL, body_pose=pose,
        betas=betas, transl=transl, vertices=out.vertices[0].numpy(), joints=out.joints[0].numpy(),
    )  # fmt: skip


def keypoints_of(body: BodyFit) -> np.ndarray:
    values = [
        torch.tensor(np.asarray(v)[None], dtype=torch.float32)
        for v in (body.global_orient, body.body_pose, body.betas, body.transl)
    ]
    with torch.no_grad():
        points = body_model().keypoints(*values)[0].numpy()
    return np.column_stack([project(points, INTRINSICS), np.ones(len(points))])


def wall(body: BodyFit, region: str, gap: float) -> np.ndarray:
    """Points of a plane across the view, `gap` metres nearer to the camera than the region."""
    hand = body.vertices[body_regions().vertices[region]]
    x, y = np.meshgrid(np.linspace(-0.3, 0.3, 25), np.linspace(-0.3, 0.3, 25))
    centre = hand.mean(0)
    depth = np.full(x.size, hand[:, 2].min() - gap)
    return np.column_stack([x.ravel() + centre[0], y.ravel() + centre[1], depth])


def refine(body: BodyFit, gap: float, region: str = "right_hand"):
    target = LimbTarget(region, wall(body, region, gap))
    return refine_limbs(
        body_model(), body_regions().vertices, body, keypoints_of(body), INTRINSICS, [target],
        SETTINGS,
    )  # fmt: skip


def test_the_hand_closes_most_of_the_gap_and_stays_where_it_is_seen():
    body = standing()
    refined = refine(body, gap=0.08)
    assert refined is not None
    assert refined.before["right_hand"] == pytest.approx(0.09, abs=0.02)
    assert refined.after["right_hand"] < 0.5 * refined.before["right_hand"]
    moved = body.model_copy(update={"body_pose": refined.body_pose})
    off = np.linalg.norm(keypoints_of(moved)[:, :2] - keypoints_of(body)[:, :2], axis=1)
    height = np.ptp(project(body.vertices, INTRINSICS)[:, 1])
    assert off.max() < 0.04 * height


def test_only_the_joints_of_the_touching_limb_move():
    body = standing()
    refined = refine(body, gap=0.08)
    assert refined is not None
    change = (refined.body_pose - body.body_pose).reshape(23, 3)
    names = list(body_model().joint_names)[1:]
    moved = {name for name, row in zip(names, change, strict=True) if np.abs(row).max() > 1e-5}
    assert moved <= {f"right_{joint}" for joint in ("collar", "shoulder", "elbow", "wrist")}
    assert {"right_shoulder"} <= moved
    left = body_regions().vertices["left_hand"]
    np.testing.assert_allclose(refined.vertices[left], body.vertices[left], atol=1e-4)


@pytest.mark.parametrize("gap", [-0.001, 0.6])
def test_a_limb_that_touches_or_is_out_of_reach_is_left_alone(gap):
    body = standing()
    target = wall(body, "right_hand", gap)
    if gap < 0:
        target = body.vertices[body_regions().vertices["right_hand"]]
    found = refine_limbs(
        body_model(), body_regions().vertices, body, keypoints_of(body), INTRINSICS,
        [LimbTarget("right_hand", target), LimbTarget("butt", target)], SETTINGS,
    )  # fmt: skip
    assert found is None


def test_limbs_cannot_move_on_a_body_whose_scale_is_free():
    with pytest.raises(ValueError, match="human_scale fixed"):
        JointConfig(limbs="refined", human_scale="free")
