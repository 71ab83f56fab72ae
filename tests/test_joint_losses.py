"""Loss terms against closed forms, a slow reference and finite differences."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hoi.joint import losses
from hoi.joint.config import TermName
from hoi.joint.contacts import ContactPair
from hoi.joint.correspondence import (
    cheapest_alternatives,
    nearest,
    nearest_reference,
    pair_table,
)
from hoi.joint.phosa import visible_faces
from hoi.joint.problem import Problem
from hoi.joint.signed_distance import SignedDistanceGrid, body_signed_distance
from hoi.joint.terms import TERMS, Placement, weighted_terms
from hoi.rendering import depth_map
from joint_scene import CUBE, CUBE_FACES, METHODS, method_config, problem_of, sitting_scene

# ------------------------------------------------------------------------------ closed forms


def face_grid(x: float) -> torch.Tensor:
    """25 points on the face of a unit cube at x."""
    y, z = torch.meshgrid(torch.linspace(-0.4, 0.4, 5), torch.linspace(-0.4, 0.4, 5), indexing="ij")
    return torch.stack([torch.full_like(y, x), y, z], -1).reshape(1, 25, 3)


def test_two_touching_cubes_have_no_contact_loss_and_a_gap_costs_its_square():
    weights = torch.full((1, 25), 1 / 25)
    assert losses.contact(face_grid(0.5), face_grid(0.5), weights).item() == 0
    assert losses.contact(face_grid(0.5), face_grid(0.8), weights).item() == pytest.approx(0.09)


def test_normals_that_oppose_cost_nothing_and_equal_ones_cost_two():
    up = torch.tensor([0.0, 0, 1]).expand(1, 4, 3)
    side = torch.tensor([1.0, 0, 0]).expand(1, 4, 3)
    weights = torch.full((1, 4), 0.25)
    assert losses.normal(up, -up, weights).item() == 0
    assert losses.normal(up, up, weights).item() == 2
    assert losses.normal(up, side, weights).item() == 1


def test_the_indicator_accepts_opposing_normals_only():
    up = torch.tensor([0.0, 0, 1])
    tilted = torch.tensor([0.0, math.sin(1.7), math.cos(1.7)])
    assert losses.opposing(up, -up)
    assert losses.opposing(up, tilted)
    assert not losses.opposing(up, up)


def linear_field() -> SignedDistanceGrid:
    """f = x - 0.2 on the box [-1, 1]^3, which trilinear interpolation reproduces."""
    x = torch.linspace(-1, 1, 5, dtype=torch.float64)
    one = torch.ones(3, dtype=torch.float64)
    return SignedDistanceGrid((x - 0.2)[:, None, None].expand(5, 5, 5), -one, one)


def test_penetration_is_the_mean_depth_of_points_inside():
    points = torch.tensor([[[0.1, 0, 0.3], [0.15, 0.2, 0], [0.7, 0, 0], [9.0, 0, 0]]]).double()
    found = losses.penetration(points, linear_field(), torch.ones(1).double())
    assert found.item() == pytest.approx((0.1 + 0.05) / 4)


def test_a_larger_person_has_the_scaled_field():
    points = torch.tensor([[[0.2, 0, 0]]]).double()  # of a body twice the size: f = 2 (0.1 - 0.2)
    found = losses.penetration(points, linear_field(), torch.tensor([2.0]).double())
    assert found.item() == pytest.approx(0.2)


def test_the_distance_field_of_a_cube_is_its_signed_distance():
    field = body_signed_distance(CUBE, CUBE_FACES, cells=33, margin=0.5)
    points = torch.tensor([[0.0, 0, 0], [0.75, 0, 0], [0.4, 0.1, 0], [0, 0.25, 0]])
    expected = torch.tensor([-0.5, 0.25, -0.1, -0.25])
    assert torch.allclose(field(points), expected, atol=0.02)
    assert field(torch.tensor([[50.0, 0, 0]])).item() > 0


def test_scale_terms_are_squared_differences():
    scale, extent = torch.tensor([0.9]), torch.tensor([1.0])
    assert losses.object_scale(scale, extent, 0.8).item() == pytest.approx(0.01)
    assert losses.human_scale(torch.tensor([1.2])).item() == pytest.approx(0.04)
    # PHOSA's unit of scale is 2 m
    assert losses.phosa_object_scale(scale, extent, 0.8).item() == pytest.approx(0.0025)


def test_ground_compares_the_lowest_points_along_up():
    up = torch.tensor([0.0, -1.0, 0.0])  # image up
    soles = torch.tensor([[0.0, 1.0, 3.0], [0.3, 0.9, 3.0]])
    legs = torch.tensor([[[0.0, 0.0, 2.0], [0.0, 1.3, 2.0]]])
    assert losses.ground(legs, soles, torch.ones(1), up).item() == pytest.approx(0.09)
    assert losses.ground(legs, soles, torch.tensor([1.3]), up).item() == pytest.approx(0)


@pytest.mark.parametrize(
    ("object_stands", "feet_stand", "floating", "sunk"),
    [
        (True, True, 0.09, 0.09),  # one floor
        (True, False, 0.09, 0.0),  # feet may hang above the object's floor
        (False, True, 0.0, 0.09),  # what is lifted is not below the feet's floor
        (False, False, 0.0, 0.0),  # nobody shows where the floor is
    ],
)
def test_the_floor_is_where_somebody_stands_and_nobody_is_below(
    object_stands, feet_stand, floating, sunk
):
    up = torch.tensor([0.0, -1.0, 0.0])
    soles = torch.tensor([[0.0, 1.0, 3.0]])
    legs = torch.tensor([[[0.0, 0.7, 2.0]], [[0.0, 1.3, 2.0]]])  # 0.3 m above, 0.3 m below
    costs = losses.ground(legs, soles, torch.ones(2), up, object_stands, feet_stand)
    assert costs.tolist() == pytest.approx([floating, sunk])


def test_phosa_centroids_cost_the_mean_over_axes_where_active():
    first, second = torch.tensor([[0.0, 0, 0]] * 2), torch.tensor([[0.3, 0, 0.6]] * 2)
    found = losses.centroid_distance(first, second, torch.tensor([True, False]))
    assert found.tolist() == pytest.approx([(0.09 + 0.36) / 3, 0])


def test_phosa_parts_interact_when_grown_boxes_overlap_at_near_depths():
    box = torch.tensor([[0.0, 0, 10, 10]])
    right = torch.tensor([[12.0, 0, 22, 10]])  # 2 px apart: each grows by 1.5 at 30 %
    near, far = torch.tensor([[2.0, 3.0]]), torch.tensor([[5.5, 6.0]])
    assert losses.interacting(box, right, near, near, 0.3, 2.0)
    assert not losses.interacting(box, right, near, near, 0.1, 2.0)
    assert not losses.interacting(box, right, near, far, 0.3, 2.0)
    assert losses.interacting(box, right, near, far, 0.3, 3.0)


def test_ordinal_depth_starts_at_log_two_and_stops_at_the_clamp():
    found = losses.ordinal_depth(torch.tensor([0.0, 1.0, 2.0, 7.0]), 2.0)
    expected = [math.log(2), math.log(1 + math.e), math.log(1 + math.e**2)]
    assert found.tolist() == pytest.approx([*expected, expected[-1]])


def test_phosa_silhouette_counts_per_kept_pixel():
    assert losses.phosa_silhouette(torch.tensor([30.0]), 120.0).item() == 0.25


# ------------------------------------------------------------------------------ correspondences


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_the_fast_search_finds_the_same_pairs_as_distance_matrices(seed, only_opposing):
    generator = torch.Generator().manual_seed(seed)

    def normals(*shape: int) -> torch.Tensor:
        return torch.nn.functional.normalize(torch.randn(*shape, generator=generator), dim=-1)

    objects = {"seat": np.arange(0, 7), "back": np.arange(7, 12)}
    bodies = {"butt": np.arange(0, 5), "hand": np.arange(5, 9)}
    table = pair_table(
        [
            ContactPair(("seat",), ("butt",), True),
            ContactPair(("seat", "back"), ("hand",), False),
            ContactPair(("back",), ("butt", "hand"), True, 0.5),
        ],
        objects,
        bodies,
    )
    present = torch.ones(3, 12, dtype=torch.bool)
    present[1, 7:] = False
    arguments = (
        table,
        torch.randn(3, 12, 3, generator=generator),
        normals(3, 12, 3),
        present,
        torch.randn(9, 3, generator=generator),
        normals(9, 3),
        torch.tensor([1.0, 0.8, 1.3]),
        only_opposing,
    )
    fast, slow = nearest(*arguments), nearest_reference(*arguments)
    assert torch.equal(fast[0], slow[0])
    assert torch.equal(fast[1], slow[1])
    assert (fast[0][1, -5:] == -1).all()  # this exemplar has no back
    assert table.row_weights.sum() == pytest.approx(2.5)


def test_only_the_cheapest_alternative_counts_and_ties_go_to_the_first():
    costs = torch.tensor([[3.0, 1.0, 5.0, 2.0], [1.0, 1.0, 0.0, 0.0]])
    active = cheapest_alternatives(costs, np.array([0, 0, -1, -1]))
    assert active.tolist() == [[False, True, True, True], [True, False, True, True]]


def test_visible_faces_agree_with_the_depth_map():
    vertices = CUBE @ np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]]) + [0.1, 0.2, 3]
    intrinsics = np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]])
    index, depth = visible_faces(vertices, CUBE_FACES, intrinsics, 64, 64)
    expected = depth_map(vertices, CUBE_FACES, intrinsics, 64, 64)
    assert (np.isfinite(depth) != np.isfinite(expected)).mean() < 0.005
    both = np.isfinite(depth) & np.isfinite(expected)
    np.testing.assert_allclose(depth[both], expected[both], rtol=1e-5)
    assert ((index >= 0) == np.isfinite(depth)).all()


# ------------------------------------------------------------------------------ gradients


def in_double(value):
    """A copy of a (nested) dataclass with every float tensor in double precision."""
    if isinstance(value, torch.Tensor):
        return value.double() if value.is_floating_point() else value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        if type(value).__name__ in ("Roi", "MeshTopology", "PairTable", "OrdinalScene"):
            return value
        fields = {f.name: in_double(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return dataclasses.replace(value, **fields)
    if isinstance(value, tuple):
        return tuple(in_double(item) for item in value)
    return value


@pytest.fixture(scope="module")
def scene():
    return sitting_scene(second=True)


def displaced(problem: Problem, seed: int = 0) -> torch.Tensor:
    """Variables some centimetres, degrees and percent away from the start."""
    noise = torch.randn(problem.start.shape, generator=torch.Generator().manual_seed(seed))
    noise[:, 9] -= 2.0  # nearer to the camera: the order of chair and person is wrong somewhere
    return problem.start + 0.03 * noise.to(problem.start)


EXACT = [n for n in TermName.__args__ if n not in ("reprojection", "phosa_silhouette")]


@pytest.mark.parametrize("term", EXACT)
def test_gradients_equal_finite_differences(scene, term):
    config = method_config(
        "ours",
        terms={term: 1.0, "contact": 1.0},
        human_scale="free",
        limbs="fixed",
        opposing_normals=True,
    )
    problem = in_double(problem_of(scene, config))
    start = displaced(problem).double()

    def value(variables: torch.Tensor) -> torch.Tensor:
        return TERMS[term](problem, Placement(problem, variables)).sum()

    variables = start.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(value(variables), variables)
    assert gradient.abs().max() > 0
    step = 1e-6
    numeric = torch.zeros_like(gradient)
    with torch.no_grad():
        for index in np.ndindex(*start.shape):
            ahead, behind = start.clone(), start.clone()
            ahead[index] += step
            behind[index] -= step
            numeric[index] = (value(ahead) - value(behind)) / (2 * step)
    torch.testing.assert_close(
        gradient, numeric, rtol=2e-4, atol=2e-4 * float(gradient.abs().max())
    )


@pytest.mark.parametrize("name", ["phosa_silhouette", "reprojection"])
def test_silhouette_gradients_integrate_to_the_loss(scene, name):
    """Along a path of several pixels; a single step would see the noise of single pixels."""
    config = method_config("ours", terms={name: 1.0}, edge_weight=0.0, silhouette_resolution=256)
    problem = problem_of(scene, config)
    start, end = displaced(problem), displaced(problem, seed=5)
    values, slopes = [], []
    for share in torch.linspace(0, 1, 60):
        variables = (start + share * (end - start)).requires_grad_()
        loss = TERMS[name](problem, Placement(problem, variables)).sum()
        (gradient,) = torch.autograd.grad(loss, variables)
        values.append(float(loss.detach()))
        slopes.append(float((gradient * (end - start)).sum()))
    change = values[-1] - values[0]
    assert abs(change) > 0.1 * values[0]
    assert np.trapezoid(slopes, dx=1 / 59) == pytest.approx(change, rel=0.05)


def test_scaling_about_the_camera_keeps_the_silhouette(scene):
    problem = problem_of(scene, method_config("ours"))
    scaled = problem.start.clone()
    scaled[:, 9] += 0.3
    first, second = Placement(problem, problem.start), Placement(problem, scaled)
    assert torch.equal(first.silhouette[0], second.silhouette[0])
    factor = math.exp(0.3)
    torch.testing.assert_close(second.vertices, factor * first.vertices, rtol=1e-4, atol=1e-5)
    assert first.silhouette[1][0] > 0.93  # the object fit of the scene is exact


@pytest.mark.parametrize("name", METHODS.methods)
def test_every_method_evaluates_every_term_it_lists(scene, name):
    problem = problem_of(scene, method_config(name))
    config = method_config(name)
    values = weighted_terms(problem, config.terms, problem.start)
    assert values.shape == (len(config.terms), problem.num_hypotheses)
    assert torch.isfinite(values).all()


def test_no_usable_contact_means_zero_not_an_error(scene):
    scene = dataclasses.replace(scene, prior=scene.prior.model_copy(deep=True))
    nothing = scene.prior.retrieved.model_copy(update={"contacts": []})
    scene.prior = scene.prior.model_copy(update={"retrieved": nothing})
    config = method_config("ours")
    problem = problem_of(scene, config)
    values = weighted_terms(problem, config.terms, problem.start)
    named = dict(zip(config.terms, values, strict=True))
    assert named["contact"].tolist() == named["normal"].tolist() == [0, 0]
