"""Silhouettes: against slow references, finite differences and other people's rasterisers."""

import math

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hoi.geometry import axis_angle_to_matrix, project, uniform_rotations
from hoi.rendering import (
    MeshTopology,
    SilhouetteTarget,
    pose_silhouette_iou,
    pose_silhouette_loss,
    reference,
    render_silhouette,
    silhouette_iou,
    silhouette_loss,
    torch_backend,
)


def box(size, centre):
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return corners * size + centre, np.array(faces)


def boxes(*parts):
    vertices, faces, count = [], [], 0
    for size, centre in parts:
        v, f = box(size, centre)
        vertices.append(v)
        faces.append(f + count)
        count += len(v)
    return np.concatenate(vertices).astype(np.float32), np.concatenate(faces)


@pytest.fixture(scope="module")
def chair():
    legs = [((0.05, 0.45, 0.05), (x, -0.23, z)) for x in (-0.2, 0.2) for z in (-0.2, 0.2)]
    return boxes(
        ((0.47, 0.06, 0.46), (0, 0, 0)), ((0.43, 0.5, 0.05), (0, 0.25, -0.19)), *legs,
        ((0.05, 0.04, 0.4), (0.21, 0.2, 0)), ((0.05, 0.2, 0.05), (0.21, 0.1, 0.18)),
    )  # fmt: skip


def camera(resolution):
    return np.array(
        [[2.0 * resolution, 0, resolution / 2], [0, 2.0 * resolution, resolution / 2], [0, 0, 1]]
    )


def poses(count, seed=0, depth=1.9):
    generator = torch.Generator().manual_seed(seed)
    rotations = uniform_rotations(count, generator)
    shift = torch.tensor([0.0, 0.0, depth]) + 0.05 * torch.randn(count, 3, generator=generator)
    return rotations, shift


def projected(mesh, resolution, count=3, seed=0):
    rotations, shift = poses(count, seed)
    placed = torch.from_numpy(mesh[0]) @ rotations.transpose(1, 2) + shift[:, None]
    return project(placed, camera(resolution))


def topology_of(mesh):
    return MeshTopology.from_faces(mesh[1], len(mesh[0]))


@pytest.mark.parametrize("resolution", [33, 64, 128])
def test_coverage_at_pixel_centres_is_that_of_the_triangles(chair, resolution):
    xy = projected(chair, resolution)
    image = render_silhouette(xy, topology_of(chair), resolution, resolution, antialias=False)
    for one, points in zip(image, xy, strict=True):
        expected = reference.covered(points.numpy(), chair[1], resolution, resolution)
        assert (one.numpy() != expected).sum() <= 1  # a sample on an edge may fall either way


def test_antialiased_coverage_is_near_supersampled_coverage(chair):
    xy = projected(chair, 128)
    image = render_silhouette(xy, topology_of(chair), 128, 128)
    for one, points in zip(image, xy, strict=True):
        fraction = reference.coverage(points.numpy(), chair[1], 128, 128)
        assert abs(one.numpy() - fraction).mean() < 0.003
        assert one.sum().item() == pytest.approx(fraction.sum(), rel=0.01)


def test_a_convex_outline_agrees_with_opencv():
    vertices, faces = boxes(((1.0, 1.0, 1.0), (0, 0, 0)))
    xy = projected((vertices, faces), 256, count=4)
    image = render_silhouette(xy, topology_of((vertices, faces)), 256, 256, antialias=False)
    for one, points in zip(image.numpy(), xy.numpy(), strict=True):
        hull = cv2.convexHull(((points - 0.5) * 16).round().astype(np.int32))
        drawn = np.zeros((256, 256), np.uint8)
        cv2.fillPoly(drawn, [hull], 1, shift=4)
        overlap = (one * drawn).sum() / np.maximum(one, drawn).sum()
        assert overlap > 0.985  # fillPoly also paints the pixels its border line touches
        missed = (drawn == 0) & (one > 0)
        assert missed.sum() <= 0.002 * one.sum()  # its vertices are rounded to 1/16 pixel


def loss_and_gradient(xy, topology, target, backend, dtype=torch.float32):
    points = xy.to(dtype).clone().requires_grad_()
    loss, iou = silhouette_loss(points, topology, target, 1.0, 0.4, backend=backend)
    loss.sum().backward()
    return loss.detach().float(), iou.float(), points.grad.float()


def occluded_target(mesh, xy, size):
    mask = render_silhouette(xy[:1], topology_of(mesh), size, size)[0].numpy()
    keep = np.ones((size, size), np.float32)
    keep[:, :30] = 0
    keep[60:] = 0.5
    return SilhouetteTarget(mask, keep)


def test_loss_and_gradient_equal_the_plain_reference(chair):
    xy, topology = projected(chair, 96), topology_of(chair)
    target = occluded_target(chair, xy, 96)
    loss, iou, grad = loss_and_gradient(xy, topology, target, "numba")
    expected, expected_iou, exact = loss_and_gradient(xy, topology, target, "reference")
    torch.testing.assert_close(loss, expected, rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(iou, expected_iou, rtol=1e-4, atol=1e-4)
    for one, other in zip(grad, exact, strict=True):
        assert (one - other).norm() < 1e-3 * other.norm().clamp(min=1)


@pytest.mark.parametrize("size", [64, 97])
def test_the_torch_back_end_equals_the_kernels(chair, size, monkeypatch):
    """Tightly: the same algorithm, in the same order, in the same precision."""
    xy, topology = projected(chair, size, count=9, seed=3), topology_of(chair)
    target = occluded_target(chair, xy, size)
    monkeypatch.setattr(torch_backend, "_MOST_PIXELS", 4 * size * size)  # three pieces
    for ours, kernels in zip(
        loss_and_gradient(xy, topology, target, "torch"),
        loss_and_gradient(xy, topology, target, "numba"),
        strict=True,
    ):
        torch.testing.assert_close(ours, kernels, rtol=1e-4, atol=2e-4 * float(kernels.abs().max()))
    assert torch.equal(
        render_silhouette(xy, topology, size, size, antialias=False, backend="torch"),
        render_silhouette(xy, topology, size, size, antialias=False),
    )
    smooth = [xy.clone().requires_grad_() for _ in range(2)]
    for points, name in zip(smooth, ("torch", "numba"), strict=True):
        render_silhouette(points, topology, size, size, backend=name).square().sum().backward()
    torch.testing.assert_close(smooth[0].grad, smooth[1].grad, rtol=1e-3, atol=1e-2)
    scores = silhouette_iou(xy, topology, target, backend="torch")
    torch.testing.assert_close(scores, silhouette_iou(xy, topology, target), rtol=1e-5, atol=1e-6)


def test_the_torch_back_end_in_float64_equals_the_reference(chair):
    xy, topology = projected(chair, 80, seed=5), topology_of(chair)
    target = occluded_target(chair, xy, 80)
    ours = loss_and_gradient(xy, topology, target, "torch", torch.float64)
    exact = loss_and_gradient(xy, topology, target, "reference", torch.float64)
    for one, other in zip(ours, exact, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-5 * float(other.abs().max()))


@pytest.mark.parametrize("backend", ["torch", "reference"])
def test_every_back_end_places_meshes_and_cuts_them_at_the_near_plane(backend):
    mesh = boxes(((0.5, 0.5, 3.0), (0, 0, 0)))
    topology, vertices = topology_of(mesh), torch.from_numpy(mesh[0])
    rotations, _ = poses(3, seed=4)
    shift = torch.tensor([[0.2, 0.1, 3.0], [0.4, 0.3, 0.4], [0.1, 0, 2.5]])
    target = SilhouetteTarget(np.pad(np.ones((30, 30)), 17))
    results = []
    for name in (backend, "numba"):
        moving = shift.clone().requires_grad_()
        given = (vertices, rotations, moving, camera(64), topology, target)
        loss, iou = pose_silhouette_loss(*given, 1.0, 0.2, backend=name)
        loss.sum().backward()
        score = pose_silhouette_iou(*given, backend=name)
        results.append((loss.detach(), iou, score, moving.grad / moving.grad.norm()))
    for ours, kernels in zip(*results, strict=True):
        torch.testing.assert_close(ours, kernels, rtol=2e-3, atol=2e-3)


def test_an_unknown_back_end_is_named(chair):
    with pytest.raises(ValueError, match="'opengl'"):
        render_silhouette(projected(chair, 8), topology_of(chair), 8, 8, backend="opengl")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_on_a_cuda_device_the_results_are_those_of_the_cpu(chair):
    xy, topology = projected(chair, 128, count=16, seed=6), topology_of(chair)
    target = occluded_target(chair, xy, 128)
    on_device = loss_and_gradient(xy.cuda(), topology, target, None)
    for ours, kernels in zip(
        on_device, loss_and_gradient(xy, topology, target, "numba"), strict=True
    ):
        assert ours.is_cuda
        scale = float(kernels.abs().max())
        torch.testing.assert_close(ours.cpu(), kernels, rtol=1e-4, atol=5e-4 * scale)


def test_the_torch_back_end_makes_every_tensor_where_its_input_is(chair):
    """No GPU needed: what forgot its device would land on the default one, which has no data."""
    xy, topology = projected(chair, 64, count=3, seed=6), topology_of(chair)
    target = occluded_target(chair, xy, 64)
    with torch.device("meta"):
        elsewhere = loss_and_gradient(xy, topology, target, "torch")
        score = silhouette_iou(xy, topology, target, backend="torch")
        image = render_silhouette(xy, topology, 64, 64, backend="torch")
    for ours, usual in zip(
        elsewhere, loss_and_gradient(xy, topology, target, "torch"), strict=True
    ):
        torch.testing.assert_close(ours, usual, rtol=0, atol=0)
    assert score.equal(silhouette_iou(xy, topology, target, backend="torch"))
    assert image.equal(render_silhouette(xy, topology, 64, 64, backend="torch"))


def test_the_image_version_has_the_loss_and_gradient_of_the_fused_one(chair):
    topology = topology_of(chair)
    xy = projected(chair, 64)
    mask = torch.from_numpy(reference.coverage(xy[2].numpy(), chair[1], 64, 64)).float()
    fused, direct = xy.clone().requires_grad_(), xy.clone().requires_grad_()
    loss, iou = silhouette_loss(fused, topology, SilhouetteTarget(mask.numpy()))
    loss.sum().backward()
    image = render_silhouette(direct, topology, 64, 64)
    expected = (image - mask).square().sum((1, 2))
    expected.sum().backward()
    torch.testing.assert_close(loss, expected.detach(), rtol=1e-4, atol=1e-2)
    torch.testing.assert_close(fused.grad, direct.grad, rtol=1e-3, atol=1e-4)
    shared = torch.minimum(image, mask).sum((1, 2))
    union = torch.maximum(image, mask).sum((1, 2))
    torch.testing.assert_close(iou, (shared / union).detach(), rtol=1e-3, atol=1e-4)


def test_pose_gradient_matches_differences_of_supersampled_coverage(chair):
    """L = sum W S for a smooth W; central differences of exact coverage are the reference."""
    resolution, samples, step = 256, 6, 0.01
    vertices, faces = torch.from_numpy(chair[0]), chair[1]
    topology = topology_of(chair)
    rotations, shifts = poses(2, seed=7)

    def field(size):
        y, x = (np.mgrid[0:size, 0:size] + 0.5) / size
        return np.sin(5 * x + 2 * y) + np.cos(7 * y - 3 * x + 1)

    def image_points(parameters, k, size):
        turn = axis_angle_to_matrix(parameters[:3])
        placed = vertices @ (turn @ rotations[k]).T + shifts[k] + parameters[3:]
        return project(placed, camera(size))

    weight, fine_weight = torch.from_numpy(field(resolution)).float(), field(resolution * samples)
    fine = resolution * samples
    for k in range(len(rotations)):
        parameters = torch.zeros(6, requires_grad=True)
        xy = image_points(parameters, k, resolution)
        (render_silhouette(xy[None], topology, resolution, resolution)[0] * weight).sum().backward()
        numeric = np.zeros(6)
        for i in range(6):
            values = []
            for sign in (1, -1):
                moved = torch.zeros(6)
                moved[i] = sign * step
                covered = reference.covered(image_points(moved, k, fine).numpy(), faces, fine, fine)
                values.append((covered * fine_weight).sum() / samples**2)
            numeric[i] = (values[0] - values[1]) / (2 * step)
        analytic = parameters.grad.numpy()
        error = np.linalg.norm(analytic - numeric) / np.linalg.norm(numeric)
        cosine = analytic @ numeric / np.linalg.norm(analytic) / np.linalg.norm(numeric)
        assert error < 0.05
        assert cosine > 0.999


def test_edge_term_is_zero_on_the_outline_and_pulls_towards_it():
    vertices, faces = boxes(((1.0, 1.0, 1.0), (0, 0, 0)))
    topology = topology_of((vertices, faces))
    square = project(torch.from_numpy(vertices) + torch.tensor([0.0, 0.0, 4.0]), camera(128))[None]
    target = SilhouetteTarget(render_silhouette(square, topology, 128, 128)[0].numpy())
    there, _ = silhouette_loss(square, topology, target, 0.0, 1.0)
    away = (square + torch.tensor([8.5, 0.0])).requires_grad_()
    loss, _ = silhouette_loss(away, topology, target, 0.0, 1.0)
    loss.sum().backward()
    assert loss.item() > there.item() + 50
    assert away.grad[0, :, 0].sum() > 0  # moving further right costs more
    assert abs(away.grad[0, :, 1].sum()) < 0.1 * away.grad[0, :, 0].sum()
    step = 0.2  # short of the next pixel centre, where the outline has more pairs
    nearer, _ = silhouette_loss(away.detach() - torch.tensor([step, 0.0]), topology, target, 0.0, 1)
    slope = (loss - nearer).item() / step
    assert slope == pytest.approx(away.grad[0, :, 0].sum().item(), rel=0.01)


def test_pixels_that_are_not_kept_change_nothing(chair):
    topology = topology_of(chair)
    xy = projected(chair, 64)
    keep = np.ones((64, 64), np.float32)
    keep[20:44, 20:44] = 0
    clean = (reference.coverage(xy[0].numpy(), chair[1], 64, 64) > 0.5).astype(np.float32)
    scribbled = clean.copy()
    scribbled[20:44, 20:44] = np.random.default_rng(0).random((24, 24))
    results = []
    for mask in (clean, scribbled):
        points = xy.clone().requires_grad_()
        target = SilhouetteTarget(mask, keep)
        loss, iou = silhouette_loss(points, topology, target, 1.0, 0.5)
        loss.sum().backward()
        results.append((loss.detach(), iou, points.grad, silhouette_iou(xy, topology, target)))
    for first, second in zip(*results, strict=True):
        assert torch.equal(first, second)
    assert results[0][3][0] > 0.97


def test_the_score_is_the_overlap_of_the_hard_images(chair):
    topology = topology_of(chair)
    xy = projected(chair, 64, count=5)
    images = render_silhouette(xy, topology, 64, 64, antialias=False)
    keep = (np.random.default_rng(1).random((64, 64)) > 0.3).astype(np.float32)
    target = SilhouetteTarget(images[0].numpy(), keep)
    kept = images * torch.from_numpy(keep)
    expected = (kept * images[0]).sum((1, 2)) / torch.maximum(kept, kept[:1]).sum((1, 2))
    torch.testing.assert_close(silhouette_iou(xy, topology, target), expected)


def test_poses_give_what_projecting_their_vertices_gives(chair):
    topology = topology_of(chair)
    vertices = torch.from_numpy(chair[0])
    rotations, shift = poses(4, seed=3)
    linear = rotations * torch.tensor([1.0, 0.8, 1.2, 1.0])[:, None, None]
    shift[3, 2] = 0.4
    target = SilhouetteTarget(np.pad(np.ones((30, 30)), 17))
    fused = [linear.clone().requires_grad_(), shift.clone().requires_grad_()]
    plain = [linear.clone().requires_grad_(), shift.clone().requires_grad_()]
    loss, iou = pose_silhouette_loss(vertices, *fused, camera(64), topology, target, 1.0, 0.3)
    xy = project(vertices @ plain[0].transpose(1, 2) + plain[1][:, None], camera(64))
    expected, expected_iou = silhouette_loss(xy, topology, target, 1.0, 0.3)
    torch.testing.assert_close(loss, expected, rtol=1e-3, atol=1e-2)
    torch.testing.assert_close(iou, expected_iou, rtol=1e-3, atol=1e-4)
    loss[:3].sum().backward()
    expected[:3].sum().backward()
    for ours, theirs in zip(fused, plain, strict=True):
        assert (ours.grad - theirs.grad).norm() < 1e-3 * theirs.grad.norm()
    scores = pose_silhouette_iou(vertices, linear, shift, camera(64), topology, target)
    torch.testing.assert_close(scores, silhouette_iou(xy, topology, target), rtol=1e-3, atol=1e-3)


def test_neither_winding_nor_shared_vertices_matter(chair):
    vertices, faces = chair
    rng = np.random.default_rng(2)
    flipped = np.where(rng.random(len(faces))[:, None] < 0.5, faces[:, ::-1], faces)
    soup_faces = np.arange(3 * len(faces)).reshape(-1, 3)
    xy = projected(chair, 80)
    plain = render_silhouette(xy, topology_of(chair), 80, 80)
    turned = render_silhouette(xy, MeshTopology.from_faces(flipped, len(vertices)), 80, 80)
    soup = MeshTopology.from_faces(soup_faces, 3 * len(faces))
    torn = render_silhouette(xy[:, torch.from_numpy(faces.ravel())], soup, 80, 80, antialias=False)
    assert torch.equal(plain, turned)
    hard = render_silhouette(xy, topology_of(chair), 80, 80, antialias=False)
    assert (torn != hard).sum() <= 3


def test_open_and_non_manifold_meshes_are_covered_exactly():
    rng = np.random.default_rng(4)
    xy = rng.uniform(-10, 74, (14, 2)).astype(np.float32)
    faces = rng.integers(0, 14, (40, 3))  # shares edges at will, repeats vertices
    image = render_silhouette(
        torch.from_numpy(xy)[None], MeshTopology.from_faces(faces, 14), 64, 64, antialias=False
    )[0]
    assert (image.numpy() != reference.covered(xy, faces, 64, 64)).sum() <= 2


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-40, 100, width=32), st.floats(-40, 100, width=32)),
        min_size=3,
        max_size=9,
    ),
    st.integers(0, 10_000),
)
def test_any_triangles_give_finite_images_of_the_right_coverage(points, seed):
    xy = np.array(points, np.float32) + np.float32(0.137)  # off the lines of pixel centres
    faces = np.random.default_rng(seed).integers(0, len(xy), (6, 3))
    topology = MeshTopology.from_faces(faces, len(xy))
    moving = torch.from_numpy(xy)[None].requires_grad_()
    image = render_silhouette(moving, topology, 48, 56)
    image.sum().backward()
    assert torch.isfinite(image).all() and torch.isfinite(moving.grad).all()
    hard = render_silhouette(moving, topology, 48, 56, antialias=False)[0].numpy()
    coarse = reference.covered(xy, faces, 48, 56)
    assert (hard != coarse).sum() <= 2


@pytest.mark.parametrize("shift", [(500, 0), (-500, 0), (0, 500), (0, -500)])
def test_a_mesh_off_the_image_is_empty_and_has_no_gradient(chair, shift):
    xy = (projected(chair, 64) + torch.tensor(shift, dtype=torch.float32)).requires_grad_()
    target = SilhouetteTarget(np.ones((64, 64)))
    loss, iou = silhouette_loss(xy, topology_of(chair), target, 1.0, 1.0)
    loss.sum().backward()
    assert torch.allclose(loss, torch.tensor(64.0 * 64.0))
    assert (iou == 0).all() and (xy.grad == 0).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e30])
def test_faces_with_unusable_corners_are_left_out(chair, bad):
    topology = topology_of(chair)
    xy = projected(chair, 64, count=2)
    xy[0, 5, 0] = bad
    xy.requires_grad_()
    loss, iou = silhouette_loss(xy, topology, SilhouetteTarget(np.ones((64, 64))), 1.0, 1.0)
    loss.sum().backward()
    assert torch.isfinite(loss).all() and torch.isfinite(iou).all()
    assert torch.isfinite(xy.grad).all()
    whole = [i for i, face in enumerate(chair[1]) if 5 not in face]
    rest = MeshTopology.from_faces(chair[1][whole], len(chair[0]))
    broken = render_silhouette(xy, topology, 64, 64)[0]
    assert torch.equal(broken, render_silhouette(xy.detach().nan_to_num(0), rest, 64, 64)[0])


def test_meshes_in_a_batch_do_not_touch_each_other(chair):
    topology = topology_of(chair)
    xy = projected(chair, 64, count=6)
    target = SilhouetteTarget(reference.coverage(xy[0].numpy(), chair[1], 64, 64))
    together, ious = silhouette_loss(xy, topology, target, 1.0, 0.5)
    alone = torch.cat([silhouette_loss(one[None], topology, target, 1.0, 0.5)[0] for one in xy])
    assert torch.equal(together, alone)
    order = torch.tensor([3, 1, 5, 0, 2, 4])
    assert torch.equal(silhouette_loss(xy[order], topology, target, 1.0, 0.5)[1], ious[order])


def test_an_empty_mesh_draws_nothing():
    topology = MeshTopology.from_faces(np.zeros((0, 3)), 0)
    assert render_silhouette(torch.zeros(2, 0, 2), topology, 8, 8).sum() == 0


def test_every_edge_pairs_its_faces():
    topology = MeshTopology.from_faces(np.array([[0, 1, 2], [2, 1, 3], [1, 2, 4]]), 5)
    rows = [
        (*edge, *row)
        for edge, row in zip(topology.edges.tolist(), topology.edge_faces.tolist(), strict=True)
    ]
    assert (1, 2, 0, 1, 1, -1) in rows  # the first two faces of the shared edge
    assert (1, 2, 2, 1, 2, 0) in rows  # the third one, alone
    assert len(rows) == 8


def test_shapes_are_checked_at_the_door(chair):
    topology = topology_of(chair)
    target = SilhouetteTarget(np.ones((8, 8)))
    with pytest.raises(ValueError, match="expected"):
        silhouette_loss(torch.zeros(3, 2), topology, target)
    with pytest.raises(ValueError, match="vertices"):
        MeshTopology.from_faces(np.array([[0, 1, 9]]), 4)
    with pytest.raises(ValueError, match="must be one"):
        SilhouetteTarget(np.ones((4, 4)), np.ones((4, 5)))
    with pytest.raises(ValueError, match="finite"):
        SilhouetteTarget(np.full((4, 4), np.nan))
