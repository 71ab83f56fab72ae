"""Cameras that a method believes in, against closed forms."""

import numpy as np
import pytest

from hoi.geometry import model_intrinsics, project, shift_between_cameras

TRUE = np.array([[980.0, 0, 1019], [0, 980.0, 779], [0, 0, 1]])


def test_the_photo_camera_is_left_as_it_is():
    assert np.array_equal(model_intrinsics(TRUE, 1536, 2048, "photo"), TRUE)


def test_the_longest_side_camera_ignores_the_photo():
    believed = model_intrinsics(TRUE, 1536, 2048, "longest_side")
    assert np.array_equal(believed, [[2048, 0, 1024], [0, 2048, 1024], [0, 0, 1]])


def test_a_flat_thing_moves_to_where_it_looks_the_same():
    rng = np.random.default_rng(0)
    # all points at one depth: a change of focal length is exactly a change of distance
    points = np.column_stack([rng.normal(0.3, 0.4, (50, 2)), np.full(50, 2.5)])
    believed = model_intrinsics(TRUE, 1536, 2048, "longest_side")
    moved = points + shift_between_cameras(points, TRUE, believed)
    assert moved[0, 2] == pytest.approx(2.5 * 2048 / 980)
    assert np.allclose(project(moved, believed), project(points, TRUE))


def test_a_person_moves_to_where_he_looks_almost_the_same():
    rng = np.random.default_rng(1)
    points = rng.normal(0, 1, (500, 3)) * [0.25, 0.6, 0.15] + [0.2, 0.1, 3.0]
    believed = model_intrinsics(TRUE, 1536, 2048, "longest_side")
    moved = points + shift_between_cameras(points, TRUE, believed)
    error = np.linalg.norm(project(moved, believed) - project(points, TRUE), axis=1)
    height = np.ptp(project(points, TRUE)[:, 1])
    assert error.mean() < 0.03 * height


def test_no_shift_between_equal_cameras():
    points = np.random.default_rng(2).normal(0, 1, (30, 3)) + [0, 0, 4]
    assert np.allclose(shift_between_cameras(points, TRUE, TRUE), 0, atol=1e-12)
