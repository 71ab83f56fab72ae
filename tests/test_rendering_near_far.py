"""Silhouettes at the limits: past the camera, off the picture, thinner than a pixel."""

import numpy as np
import pytest
import torch

from hoi.geometry import axis_angle_to_matrix, project
from hoi.rendering import (
    MeshTopology,
    Roi,
    SilhouetteTarget,
    clip_near,
    depth_map,
    intrinsics_for,
    off_screen,
    pose_silhouette_iou,
    pose_silhouette_loss,
    render_silhouette,
    silhouette_iou,
    silhouette_loss,
)

K = np.array([[90.0, 0, 48], [0, 90.0, 40], [0, 0, 1]])
HEIGHT, WIDTH = 80, 96
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])
CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def bar(length, width, depth=0.0):
    """A long box along z, beside the camera and reaching past it."""
    return torch.tensor(CUBE * [width, width, length] + [0.0, 0.0, depth], dtype=torch.float32)


def tilted(seed):
    generator = torch.Generator().manual_seed(seed)
    turn = axis_angle_to_matrix(0.3 * torch.randn(1, 3, generator=generator))
    return turn, torch.tensor([[0.35, 0.25, 0.2]]) + 0.1 * torch.randn(1, 3, generator=generator)


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 5])
def test_what_reaches_past_the_camera_is_drawn_as_the_depth_map_draws_it(seed):
    turn, shift = tilted(seed)
    placed = bar(3.0, 0.3) @ turn[0].T + shift
    assert (placed[:, 2] < 0).any() and (placed[:, 2] > 0.5).any()
    points, faces = clip_near(placed, FACES)
    topology = MeshTopology.from_faces(faces, len(points))
    drawn = render_silhouette(project(points, K)[None], topology, HEIGHT, WIDTH, antialias=False)
    expected = np.isfinite(depth_map(placed.numpy(), FACES, K, HEIGHT, WIDTH))
    assert expected.sum() > 50
    assert (drawn[0].numpy().astype(bool) != expected).sum() <= 2


def test_placements_that_reach_past_the_camera_score_as_their_visible_part():
    topology = MeshTopology.from_faces(FACES, 8)
    vertices = bar(3.0, 0.3)
    turn, shift = tilted(1)
    turns = torch.cat([turn, torch.eye(3)[None], turn])
    shifts = torch.cat([shift, torch.tensor([[0.0, 0.0, 4.0]]), shift + 0.02])
    seen = np.isfinite(depth_map((vertices @ turn[0].T + shift).numpy(), FACES, K, HEIGHT, WIDTH))
    target = SilhouetteTarget(seen)
    ious = pose_silhouette_iou(vertices, turns, shifts, K, topology, target)
    assert ious[0] > 0.99
    assert 0.5 < ious[2] < ious[0]
    far = project(vertices + shifts[1], K)[None]
    assert ious[1] == silhouette_iou(far, topology, target)[0]
    losses, soft = pose_silhouette_loss(vertices, turns, shifts, K, topology, target)
    assert losses[1] == silhouette_loss(far, topology, target)[0][0]
    assert soft[0] > 0.95 and losses.argmin() == 0


def test_the_gradient_of_a_cut_mesh_matches_differences():
    topology = MeshTopology.from_faces(FACES, 8)
    vertices, (turn, shift) = bar(3.0, 0.3), tilted(1)
    camera, (height, width) = np.diag([6.0, 6.0, 1.0]) @ K, (6 * HEIGHT, 6 * WIDTH)
    y, x = np.mgrid[0:height, 0:width]
    target = SilhouetteTarget(0.5 + 0.5 * np.sin(0.01 * x + 0.015 * y))

    def loss(shift):
        return pose_silhouette_loss(vertices, turn, shift, camera, topology, target)[0].sum()

    moving = shift.clone().requires_grad_()
    loss(moving).backward()
    steps = 0.003 * torch.eye(3)[:, None]
    numeric = torch.stack([loss(shift + step) - loss(shift - step) for step in steps]) / 0.006
    assert (moving.grad[0] - numeric).norm() < 0.05 * numeric.norm()


def test_a_mesh_before_the_camera_is_left_as_it_is_and_one_behind_vanishes():
    placed = bar(0.5, 0.3, depth=2.0)
    points, faces = clip_near(placed, FACES)
    assert torch.equal(points, placed) and np.array_equal(faces, FACES)
    assert len(clip_near(placed - torch.tensor([0, 0, 9.0]), FACES)[1]) == 0


def test_leaving_the_picture_costs_and_the_cost_brings_it_back():
    inside = bar(0.2, 0.2, depth=2.0)[None]
    assert off_screen(inside, K, HEIGHT, WIDTH).item() == 0
    shift = torch.tensor([3.0, 0.0, 0.0], requires_grad=True)
    cost = off_screen(inside + shift, K, HEIGHT, WIDTH)
    xy = project((inside + shift).detach()[0], K)
    expected = ((xy[:, 0] - WIDTH) / (WIDTH / 2)).clamp(min=0).sum()
    assert cost.item() == pytest.approx(expected.item(), rel=1e-4)
    cost.sum().backward()
    assert shift.grad[0] > 0 and shift.grad[1].abs() < 1e-3
    behind = inside - torch.tensor([0.0, 0, 5.0])
    assert off_screen(behind, K, HEIGHT, WIDTH).item() > 3 * 8 * 0.9  # metres behind, 8 vertices
    assert off_screen(inside + torch.tensor([0, 0, 10.0]), K, HEIGHT, WIDTH, far=5.0).item() > 50


def test_a_crop_sees_parts_that_are_thinner_than_a_pixel_of_the_photo():
    rod = bar(0.002, 0.0037, depth=0.0) * torch.tensor([1.0, 60.0, 1.0]) + torch.tensor([0, 0, 2.0])
    topology = MeshTopology.from_faces(FACES, 8)
    box = project(rod, K)
    true_area = 90.0**2 * 0.0037 * 0.222 / 4.0  # 0.17 by 10 pixels
    coarse = render_silhouette(box[None], topology, HEIGHT, WIDTH).sum().item()
    roi = Roi.around(np.r_[box.amin(0).numpy(), box.amax(0).numpy()])
    xy = project(rod, intrinsics_for(roi, K, 256))[None]
    fine = render_silhouette(xy, topology, 256, 256).sum().item() * (roi.side / 256) ** 2
    assert abs(coarse / true_area - 1) > 0.3
    assert fine == pytest.approx(true_area, rel=0.05)
