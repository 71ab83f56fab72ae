"""What the joint stage does with more than the paper asks: ranges, arrangement, no contact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from hoi.artifacts import Arrangement, Extent, Extents
from hoi.body import DEFAULT_BODY
from hoi.exemplars import save_library
from hoi.joint import losses
from hoi.joint.arrangement import UNSAID, misplacement
from hoi.joint.reading import what_is_read
from hoi.joint.stage import JointStage
from hoi.joint.terms import Placement, object_scale
from joint_scene import box_chair, method_config, problem_of, sitting_scene

QUICK = {"optimiser": "adam", "iterations": 15, "learning_rate": 1e-2}
NARROW = Extent(low=0.3, typical=0.35, high=0.4)


def with_prior(scene, **changes):
    scene.prior = scene.prior.model_copy(update=changes)
    return scene


def with_sitting(scene, **changes):
    return with_prior(scene, retrieved=scene.prior.retrieved.model_copy(update=changes))


# -------------------------------------------------------------------------------------- size


def test_a_size_within_its_ranges_costs_nothing_and_one_outside_the_square_of_its_way():
    sizes = torch.tensor([[0.5, 1.0, 0.5]] * 3)
    low, high = torch.tensor([0.4, 0.8, 0.0]), torch.tensor([0.6, 1.1, torch.inf])
    cost = losses.object_size_range(torch.tensor([1.0, 0.5, 2.0]), sizes, low, high)
    expected = [0.0, 0.15**2 + 0.3**2, 0.4**2 + 0.9**2]
    assert cost.tolist() == pytest.approx(expected, abs=1e-6)


def test_ranges_take_the_place_of_the_single_size_where_the_prior_has_them():
    scene = with_prior(sitting_scene(), extents=Extents(height=NARROW))
    ranged, single = method_config("ours", size="range"), method_config("ours")
    for config, height in ((ranged, NARROW.high), (single, 0.9)):
        problem = problem_of(scene, config)
        start = problem.start.clone()
        start[:, 9] = np.log(height / 0.9)  # the box chair is 0.9 m high
        assert object_scale(problem, Placement(problem, start)).item() == pytest.approx(0, abs=1e-9)
    unsaid = with_prior(sitting_scene(), extents=None)
    assert problem_of(unsaid, ranged).size_range is None
    assert what_is_read(scene.prior, ranged).extents == scene.prior.extents
    assert what_is_read(scene.prior, single).extents is None


# ------------------------------------------------------------------------------- arrangement


@pytest.mark.parametrize(
    ("relation", "facing", "there", "front"),
    [
        ("front", "", (0, 0, 1), None),
        ("behind", "", (0, 0, -1), None),
        ("above", "", (0, 1, 0), None),
        ("below", "", (0, -1, 0), None),
        ("beside", "", (1, 0, 0), None),
        ("", "same", (1, 1, 1), (0, 0, 1)),
        ("", "opposite", (1, 1, 1), (0, 0, -1)),
        ("", "sideways", (1, 1, 1), (-1, 0, 0)),
        ("front", "opposite", (0, 0.4, 1), (0, 0.2, -1)),  # seen from above
    ],
)
def test_an_object_is_where_it_is_said_to_be(relation, facing, there, front):
    """Directions in the person's frame, y up, front +z; the scene shows the person turned."""
    scene = sitting_scene(yaw=0.6)
    c, s = np.cos(0.6), np.sin(0.6)
    to_camera = np.diag([1.0, -1, -1]) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    joints = np.asarray(scene.body.joints, float)
    fronts = np.array([front or (1, 0, 1)], float) @ to_camera.T
    said = Arrangement(relation=relation, facing=facing)
    parts = bool(relation) + bool(facing)

    def of(direction, front):
        return misplacement(said, joints, joints[:1] + direction, front)[0]

    as_said = of(np.array([there], float) @ to_camera.T, fronts)
    assert as_said == pytest.approx((2 - parts) * UNSAID / 2, abs=0.02)
    turned = np.diag([-1.0, -1, -1])
    if relation != "beside" and facing != "sideways":
        opposite = of(np.array([there], float) @ to_camera.T @ turned, fronts @ turned)
        assert opposite == pytest.approx((parts + (2 - parts) * UNSAID) / 2, abs=0.02)


def test_what_nobody_said_is_as_good_as_anywhere():
    joints = np.asarray(sitting_scene().body.joints, float)
    anywhere = np.random.default_rng(0).normal(size=(5, 3))
    assert misplacement(None, joints, anywhere, anywhere).tolist() == [UNSAID] * 5


def test_of_two_poses_the_one_that_faces_as_said_is_chosen(tmp_path):
    """The same box chair twice, once turned about: its silhouette can hardly tell."""
    save_library([box_chair()], tmp_path / "chair.npz")
    scene = sitting_scene(yaw=0.0)
    about = np.diag([-1.0, 1, -1])
    rotations, translations = scene.objects.rotations, scene.objects.translations
    assert rotations is not None and translations is not None
    scene.objects = scene.objects.model_copy(
        update={
            "exemplars": ["box", "box"],
            "rotations": np.stack([rotations[0], rotations[0] @ about]),
            "translations": np.repeat(translations, 2, 0),
            "ious": np.array([0.9, 0.9]),
        }
    )
    chosen = {}
    for facing in ("same", "opposite"):
        said = Arrangement(relation="", facing=facing)
        with_sitting(scene, arrangement=said)
        config = method_config(
            "single_action", fast=QUICK, limbs="fixed", consensus=0.0, arrangement_weight=100.0
        )
        stage = JointStage(config, DEFAULT_BODY, tmp_path)
        result = stage(
            scene.frame, scene.detection, scene.body, scene.objects,
            what_is_read(scene.prior, config), seed=3,
        )  # fmt: skip
        chosen[facing] = result.selected
        assert result.selected is not None
        placed = result.hypothesis_terms["misplacement"]
        assert placed[result.selected] == min(placed)
        assert "misplacement" in result.selection_rule
    assert chosen == {"same": 0, "opposite": 1}


# -------------------------------------------------------------------------------- no contact


def test_contacts_count_by_the_probability_that_something_touches():
    scene = with_sitting(sitting_scene(), no_contact=0.25)
    whole = problem_of(scene, method_config("ours"))
    weighed = problem_of(scene, method_config("ours", no_contact="weigh"))
    assert [pair.weight for pair in weighed.pairs] == [0.75 * p.weight for p in whole.pairs]
    assert [replace(p, weight=1.0) for p in weighed.pairs] == [
        replace(p, weight=1.0) for p in whole.pairs
    ]
