"""The batched optimisers, the depth grid and the selection rule."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from hoi.geometry import chamfer_distance
from hoi.joint.config import Schedule
from hoi.joint.optimise import Evaluated, Objective, adam, best_depth, lbfgs, minimise
from hoi.joint.problem import choose_hypotheses
from hoi.joint.select import (
    choose,
    mean_distances,
    occlusion_order_violation,
    order_violation_by_depth,
    rule_text,
    scores,
)
from hoi.joint.terms import Placement
from hoi.rendering import Roi
from joint_scene import (
    CUBE,
    CUBE_FACES,
    HEIGHT,
    WIDTH,
    inputs_of,
    method_config,
    problem_of,
    sitting_scene,
)

ADAM = Schedule(optimiser="adam", iterations=600, learning_rate=5e-2, decay=True)
LBFGS = Schedule(optimiser="lbfgs", iterations=120)


def objective(function) -> Objective:
    """An Objective from a differentiable function (K, D) -> (K,)."""

    def evaluate(variables: torch.Tensor) -> Evaluated:
        variables = variables.detach().requires_grad_()
        total = function(variables)
        (gradient,) = torch.autograd.grad(total.sum(), variables)
        good = torch.isfinite(total) & torch.isfinite(gradient).all(1)
        return Evaluated(
            torch.where(good, total, torch.inf).detach(),
            torch.where(good[:, None], gradient, 0.0),
            total.detach()[None],
        )

    return evaluate


def rosenbrock(x: torch.Tensor) -> torch.Tensor:
    return (1 - x[:, 0]).square() + 5 * (x[:, 1] - x[:, 0].square()).square()


REGION = Roi(240, 160, 160)
STARTS = torch.tensor([[-0.5, 0.5], [0.3, -0.4], [1.5, 1.0]])


@pytest.mark.parametrize("run, schedule", [(adam, ADAM), (lbfgs, LBFGS)])
def test_every_hypothesis_reaches_the_minimum(run, schedule):
    found = run(objective(rosenbrock), STARTS, schedule)
    assert found.total.max() < 1e-3
    torch.testing.assert_close(found.variables, torch.ones(3, 2), atol=0.05, rtol=0)
    assert found.curves.shape == (schedule.iterations + 1, 1, 3)
    assert torch.equal(found.terms.sum(0), found.total)


@pytest.mark.parametrize("run, schedule", [(adam, ADAM), (lbfgs, LBFGS)])
def test_a_hypothesis_ends_where_it_would_have_ended_alone(run, schedule):
    together = run(objective(rosenbrock), STARTS, schedule)
    alone = run(objective(rosenbrock), STARTS[1:2], schedule)
    assert torch.equal(together.variables[1], alone.variables[0])


def test_lbfgs_never_raises_a_loss():
    curve = lbfgs(objective(rosenbrock), STARTS, LBFGS).curves[:, 0]
    assert (curve.diff(dim=0) <= 0).all()


@pytest.mark.parametrize("run, schedule", [(adam, ADAM), (lbfgs, LBFGS)])
def test_a_loss_that_is_not_finite_harms_only_its_own_hypothesis(run, schedule):
    def cliff(x: torch.Tensor) -> torch.Tensor:
        """Not a number right of 1.2, and everywhere for the third hypothesis."""
        value = rosenbrock(x)
        broken = (x[:, 0] > 1.2) | (torch.arange(len(x)) == 2)
        return torch.where(broken, torch.nan, value)

    found = run(objective(cliff), STARTS, schedule)
    assert found.total[:2].max() < 1e-2
    assert torch.isinf(found.total[2])
    assert torch.equal(found.variables[2], STARTS[2])


def test_the_depth_grid_finds_the_scale_that_contact_wants():
    scene = sitting_scene()
    scene.prior = scene.prior.model_copy(update={"size_m": 0.72})  # 20 % too small, so too near
    config = method_config("ours")
    problem = problem_of(scene, config)
    assert Placement(problem, problem.start).scale.item() == pytest.approx(0.8)
    found = best_depth(problem, config.terms, steps=29, span=0.35)
    assert Placement(problem, found).scale.item() == pytest.approx(1.0, abs=0.04)


def test_the_depth_grid_listens_to_who_hides_whom():
    scene = sitting_scene()
    config = method_config("ours")
    problem = problem_of(scene, config)

    def only_near(factors: torch.Tensor) -> torch.Tensor:
        return 100.0 * (factors[:, None] > 0.8).float()

    found = best_depth(problem, config.terms, 29, 0.35, only_near)
    assert Placement(problem, found).scale.item() < 0.81
    free = best_depth(problem, config.terms, 29, 0.35)
    assert Placement(problem, free).scale.item() > 0.9


@pytest.mark.parametrize("name, within", [("ours", 0.06), ("paper", 0.35)])
def test_contact_pulls_the_chair_to_the_right_depth(name, within):
    scene = sitting_scene()
    scene.prior = scene.prior.model_copy(update={"size_m": 0.72})
    config = method_config(name, human_scale="fixed")
    problem = problem_of(scene, config)

    def error(variables: torch.Tensor) -> float:
        vertices = Placement(problem, variables).vertices[0].detach().numpy()
        return float(np.linalg.norm(vertices - scene.true_vertices, axis=1).mean())

    assert error(problem.start) > 0.5
    found = minimise(problem, config.terms, config.chosen_schedule)
    assert error(found.variables) < within


def test_hypotheses_keep_their_rank_and_no_exemplar_fills_the_list():
    names = ["a", "a", "b", "a", "c", "b"]
    assert choose_hypotheses(names, most=10, poses_per_exemplar=1) == [0, 2, 4]
    assert choose_hypotheses(names, most=3, poses_per_exemplar=2) == [0, 1, 2]


def test_selection_adds_the_order_violation_to_the_loss():
    total, violation = np.array([1.0, 0.9, np.inf]), np.array([0.0, 0.3, 0.0])
    assert scores(total, violation, order_weight=1.0).argmin() == 0
    assert scores(total, violation, order_weight=0.0).argmin() == 1
    unlikely = np.array([0.5, 0.0, 0.0])
    assert scores(total, violation, 1.0, unlikely, action_weight=1.0).argmin() == 1
    with pytest.raises(ValueError, match="finite"):
        scores(np.array([np.nan, np.inf]), np.zeros(2), 1.0)
    assert rule_text(0) == "lowest total loss"
    assert "occlusion" in rule_text(1.0)
    assert "expected distance" in rule_text(1.0, 0.1, 0.2)


def test_the_lowest_score_wins_and_ties_go_to_the_better_rank():
    points = [np.zeros((1, 3))] * 3
    assert choose(np.array([0.5, 0.5, 0.7]), points, consensus=0.0) == 0
    assert choose(np.array([np.inf, 0.5, 0.4]), points, consensus=0.0) == 2


def test_of_equally_likely_poses_the_one_in_the_middle_is_kept():
    points = [np.array([[x, 0.0, 0.0]]) for x in (0.0, 1.0, 1.1, 1.2, 1.3, 9.0)]
    score = np.array([0.50, 0.52, 0.51, 0.52, 0.52, 30.0])
    assert choose(score, points, consensus=0.0) == 0
    assert choose(score, points, consensus=1.0) == 2
    assert choose(score, points, consensus=1e-3) == 0  # the best is likelier by far


def test_mean_distances_agree_with_the_chamfer_distance():
    rng = np.random.default_rng(0)
    points = [rng.uniform(size=(4000, 3)) + [0, 0, i] for i in range(3)]
    found = mean_distances(points)
    assert found[0, 2] == pytest.approx(chamfer_distance(points[0], points[2]), rel=0.02)
    assert np.allclose(found, found.T) and np.all(np.diag(found) == 0)


@pytest.mark.parametrize("object_depth, expected", [(2.0, 0.0), (4.0, 1.0)])
def test_an_object_behind_the_person_it_hides_violates_the_order(object_depth, expected):
    """The mask shows the object where both are; so it must be in front of a body at 3 m."""
    thing = CUBE * 0.2 * object_depth + [0, 0, object_depth]
    person = CUBE * [1, 1, 0.2] + [0, 0, 3.0]
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[180:300, 260:380] = True
    inputs = replace(inputs_of(sitting_scene()), object_mask=mask, person_mask=~mask, roi=REGION)
    found = occlusion_order_violation([thing], [CUBE_FACES], [person], CUBE_FACES, inputs, 64, 0.02)
    assert found[0] == pytest.approx(expected, abs=0.05)


def test_the_order_at_many_depths_is_that_of_the_scaled_object():
    thing, person = CUBE * 0.4 + [0.1, 0, 3.0], CUBE * [1, 1, 0.2] + [0, 0, 3.0]
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[180:300, 260:330] = True
    inputs = replace(inputs_of(sitting_scene()), object_mask=mask, person_mask=~mask, roi=REGION)
    factors = np.array([0.5, 0.9, 1.0, 1.2])
    found = order_violation_by_depth(
        [thing], [CUBE_FACES], [person], CUBE_FACES, inputs, 64, 0.02, factors
    )
    for factor, at_once in zip(factors, found, strict=True):
        alone = occlusion_order_violation(
            [factor * thing], [CUBE_FACES], [person], CUBE_FACES, inputs, 64, 0.02
        )
        assert at_once == pytest.approx(alone, abs=0.01)
    assert found.min() < found.max()


def test_an_object_out_of_sight_counts_as_a_full_violation():
    inputs = replace(inputs_of(sitting_scene()), roi=REGION)
    aside, person = CUBE * 0.2 + [50, 0, 3.0], CUBE + [0, 0, 3.0]
    found = occlusion_order_violation([aside], [CUBE_FACES], [person], CUBE_FACES, inputs, 64, 0.02)
    assert found.tolist() == [1.0]
