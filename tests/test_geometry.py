"""Geometry against closed forms and a second library."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from hoi.geometry import (
    axis_angle_to_matrix,
    chamfer_distance,
    matrix_to_axis_angle,
    matrix_to_rotation_6d,
    project,
    rotation_6d_to_matrix,
    rotation_angle,
    sample_surface,
    scale_about_camera,
    similarity_procrustes,
    uniform_rotations,
    upright_rotations,
)

vectors = hnp.arrays(np.float64, 3, elements=st.floats(-3, 3))
K = np.array([[979.784, 0, 1018.952], [0, 979.84, 779.486], [0, 0, 1]])


@given(vectors)
def test_axis_angle_agrees_with_scipy(vector):
    ours = axis_angle_to_matrix(torch.from_numpy(vector)).numpy()
    np.testing.assert_allclose(ours, Rotation.from_rotvec(vector).as_matrix(), atol=1e-7)


def test_axis_angle_has_a_finite_gradient_at_zero():
    zero = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(axis_angle_to_matrix, (zero,), eps=1e-5, atol=1e-4)


@given(vectors)
def test_six_numbers_and_vectors_round_trip(vector):
    matrix = axis_angle_to_matrix(torch.from_numpy(vector))
    again = rotation_6d_to_matrix(matrix_to_rotation_6d(matrix))
    torch.testing.assert_close(again, matrix, atol=1e-7, rtol=0)
    back = axis_angle_to_matrix(matrix_to_axis_angle(matrix))
    torch.testing.assert_close(back, matrix, atol=1e-6, rtol=0)


def test_uniform_rotations_are_rotations_with_the_uniform_mean_angle():
    rotations = uniform_rotations(4000, torch.Generator().manual_seed(0))
    identity = torch.eye(3).expand_as(rotations)
    torch.testing.assert_close(rotations @ rotations.mT, identity, atol=1e-5, rtol=0)
    assert torch.linalg.det(rotations).min() > 0.99
    # mean angle of a uniform rotation: pi/2 + 2/pi
    mean = rotation_angle(rotations, identity).mean().item()
    assert mean == pytest.approx(np.pi / 2 + 2 / np.pi, abs=0.04)


def test_upright_objects_point_up_in_the_image_and_turn_all_the_way_round():
    rotations = upright_rotations(2000, torch.Generator().manual_seed(0))
    up, front = rotations[:, :, 1], rotations[:, :, 2]
    assert (up[:, 1] < -0.85).all()  # canonical y is image up
    yaw = torch.atan2(front[:, 0], -front[:, 2])
    counts = torch.histc(yaw, bins=8, min=-np.pi, max=np.pi)
    assert counts.min() > 150
    # a camera that looks down sees the object's top: its up axis leans towards the camera
    assert up[:, 2].mean() < 0


@given(st.floats(0.2, 5), vectors, vectors)
@settings(max_examples=50)
def test_procrustes_recovers_a_known_similarity(scale, vector, translation):
    points = np.random.default_rng(0).normal(size=(40, 3))
    rotation = Rotation.from_rotvec(vector).as_matrix()
    s, r, t = similarity_procrustes(points, scale * points @ rotation.T + translation)
    assert s == pytest.approx(scale, rel=1e-9)
    np.testing.assert_allclose(r, rotation, atol=1e-8)
    np.testing.assert_allclose(t, translation, atol=1e-8)


def test_procrustes_never_mirrors():
    points = np.random.default_rng(0).normal(size=(40, 3))
    _, rotation, _ = similarity_procrustes(points, points * [-1, 1, 1])
    assert np.linalg.det(rotation) == pytest.approx(1)


@pytest.mark.parametrize("shapes", [((2, 3), (2, 3)), ((5, 3), (6, 3))])
def test_procrustes_refuses_unusable_sets(shapes):
    with pytest.raises(ValueError, match="Procrustes"):
        similarity_procrustes(np.ones(shapes[0]), np.ones(shapes[1]))


def test_chamfer_is_the_sum_of_both_directions():
    first = np.array([[0.0, 0, 0]])
    second = np.array([[1.0, 0, 0], [3.0, 0, 0]])
    assert chamfer_distance(first, second) == pytest.approx(1 + (1 + 3) / 2)
    assert chamfer_distance(first, first) == 0


def test_surface_samples_are_spread_by_area():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [8, 0, 0], [5, 3, 0.0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])  # areas 0.5 and 4.5
    points = sample_surface(vertices, faces, 20_000, np.random.default_rng(0))
    assert (points[:, 0] < 2).mean() == pytest.approx(0.1, abs=0.01)
    inside = points[points[:, 0] < 2]
    np.testing.assert_allclose(inside.mean(0), [1 / 3, 1 / 3, 0], atol=0.02)


def test_projection_agrees_between_numpy_torch_and_the_textbook():
    points = np.random.default_rng(0).uniform([-1, -1, 1], [1, 1, 4], (10, 3))
    homogeneous = points @ K.T
    expected = homogeneous[:, :2] / homogeneous[:, 2:]
    np.testing.assert_allclose(project(points, K), expected)
    np.testing.assert_allclose(project(torch.from_numpy(points), K).numpy(), expected)


def test_points_behind_the_camera_stay_finite():
    assert np.isfinite(project(np.array([[0.1, 0.1, -3.0], [0, 0, 0.0]]), K)).all()


def test_resizing_about_the_camera_keeps_every_pixel():
    points = np.random.default_rng(1).normal(size=(20, 3))
    rotation, translation = Rotation.random(random_state=0).as_matrix(), np.array([0.1, 0.2, 3.0])
    _, moved = scale_about_camera(rotation, translation, 1.0, 1.7)
    before = project(points @ rotation.T + translation, K)
    after = project(1.7 * points @ rotation.T + moved, K)
    np.testing.assert_allclose(after, before)
