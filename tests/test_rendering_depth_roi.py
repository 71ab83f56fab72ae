"""Depth maps against ray casting, crops against direct projection, kernels made once."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hoi.geometry import project
from hoi.rendering import (
    MeshTopology,
    Roi,
    SilhouetteTarget,
    crop_mask,
    depth_map,
    intrinsics_for,
    kernels,
    pose_silhouette_iou,
    pose_silhouette_loss,
    render_silhouette,
    silhouette_iou,
    silhouette_loss,
    warm_up,
)

K = np.array([[90.0, 0, 48.0], [0, 100.0, 40.0], [0, 0, 1]])


def icosphere(radius, centre):
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return np.asarray(sphere.vertices) + centre, np.asarray(sphere.faces)


def test_depth_agrees_with_ray_casting():
    import open3d as o3d

    vertices, faces = icosphere(0.6, [0.1, -0.2, 2.0])
    other, other_faces = icosphere(0.4, [0.3, 0.2, 1.6])
    faces = np.concatenate([faces, other_faces + len(vertices)])
    vertices = np.concatenate([vertices, other])
    depth = depth_map(vertices, faces, K, 80, 96)
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    rows, columns = np.mgrid[0:80, 0:96] + 0.5
    rays = np.stack([(columns - 48) / 90, (rows - 40) / 100, np.ones_like(rows)], -1)
    origin = np.zeros_like(rays)
    hits = scene.cast_rays(np.concatenate([origin, rays], -1).astype(np.float32), nthreads=1)
    expected = hits["t_hit"].numpy()  # rays have z = 1, so distance along them is depth
    seen = np.isfinite(expected)
    assert (seen != np.isfinite(depth)).sum() <= 2
    both = seen & np.isfinite(depth)
    assert both.sum() > 500
    assert np.abs(depth[both] - expected[both]).max() < 1e-4


def test_nothing_seen_is_infinitely_far():
    vertices, faces = icosphere(0.5, [0, 0, -3.0])
    assert np.isinf(depth_map(vertices, faces, K, 20, 20)).all()
    assert np.isinf(depth_map(vertices[:0], faces[:0], K, 20, 20)).all()


def test_a_floor_through_the_camera_is_clipped_at_the_near_plane():
    floor = np.array([[-50, 1, -50], [50, 1, -50], [50, 1, 50], [-50, 1, 50.0]])
    depth = depth_map(floor, np.array([[0, 1, 2], [0, 2, 3]]), K, 80, 96)
    assert np.isinf(depth[:40]).all()  # above the horizon
    rows = np.arange(45, 80) + 0.5
    assert np.allclose(depth[45:, 30], 100 / (rows - 40), rtol=1e-4)


def test_faces_with_unusable_vertices_are_left_out():
    vertices = np.array([[-1, -1, 2], [1, -1, 2], [0, 1, 2], [0, 0, np.nan]])
    whole = depth_map(vertices[:3], np.array([[0, 1, 2]]), K, 40, 40)
    broken = depth_map(vertices, np.array([[0, 1, 2], [1, 2, 3]]), K, 40, 40)
    assert np.array_equal(whole, broken)
    with pytest.raises(ValueError, match="beyond"):
        depth_map(vertices, np.array([[0, 1, 9]]), K, 4, 4)


@settings(max_examples=50, deadline=None)
@given(
    st.floats(-50, 90), st.floats(-50, 90), st.floats(5, 200), st.integers(8, 128),
    st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.5, 5)),
)  # fmt: skip
def test_the_camera_of_a_crop_projects_into_the_crop(x0, y0, side, resolution, point):
    roi = Roi(x0, y0, side)
    full = project(np.array(point), K)
    cropped = project(np.array(point), intrinsics_for(roi, K, resolution))
    expected = (full - [x0, y0]) * resolution / side
    assert np.allclose(cropped, expected, atol=1e-6 * max(1, np.abs(expected).max()))


@settings(max_examples=50, deadline=None)
@given(st.floats(-20, 40), st.floats(-20, 40), st.floats(3, 90), st.integers(4, 48))
def test_a_crop_conserves_area(x0, y0, side, resolution):
    mask = np.zeros((40, 50), bool)
    mask[10:31, 5:33] = True
    crop = crop_mask(mask, Roi(x0, y0, side), resolution)
    height = max(0, min(31, y0 + side) - max(10, y0))
    width = max(0, min(33, x0 + side) - max(5, x0))
    cell = (side / resolution) ** 2
    assert crop.min() >= 0 and crop.max() <= 1 + 1e-5
    assert np.isclose(crop.sum() * cell, height * width, rtol=1e-3, atol=1e-2)


def test_a_crop_on_the_pixel_grid_copies_and_says_what_is_off_the_photo():
    mask = np.random.default_rng(0).random((12, 12)) > 0.5
    assert np.array_equal(crop_mask(mask, Roi(2, 3, 8), 8), mask[3:11, 2:10])
    on_photo = crop_mask(np.ones((12, 12), bool), Roi(-4, 0, 8), 8)
    assert (on_photo[:, :4] == 0).all() and np.allclose(on_photo[:, 4:], 1)


def test_a_region_around_a_box_is_square_and_centred():
    roi = Roi.around(np.array([10, 20, 50, 40]), margin=0.25)
    assert (roi.x0, roi.y0, roi.side) == (0, 0, 60)
    assert np.array_equal(roi.as_array(), [0, 0, 60])
    with pytest.raises(ValueError, match="positive"):
        Roi.around(np.array([3, 3, 3, 3]))


def test_warming_up_twice_is_harmless():
    warm_up()
    warm_up()


def test_after_warming_up_nothing_is_left_to_compile():
    """Every kernel has one signature, whatever kind of arrays and tensors comes in."""
    warm_up()
    dispatchers = [kernel for kernel in vars(kernels).values() if hasattr(kernel, "signatures")]
    public = [kernel for kernel in dispatchers if not kernel.py_func.__name__.startswith("_")]
    assert len(public) >= 6 and all(len(kernel.signatures) == 1 for kernel in public)
    faces = np.array([[0, 1, 2]], np.int64)
    topology = MeshTopology.from_faces(np.asfortranarray(faces), 3)
    target = SilhouetteTarget(np.eye(8, dtype=bool)[:, ::-1], np.ones((8, 8), np.float64))
    xy = torch.rand(2, 3, 4, dtype=torch.float64)[..., ::2].requires_grad_()
    silhouette_loss(xy, topology, target, 1, 0)[0].sum().backward()
    silhouette_iou(xy, topology, target)
    render_silhouette(xy, topology, 9, 7).sum().backward()
    vertices = torch.rand(3, 3).T
    pose = (
        vertices,
        torch.eye(3)[None].double(),
        torch.tensor([[0.0, 0, 3]]),
        np.eye(3, dtype=int),
    )
    pose_silhouette_loss(*pose, topology, target)
    pose_silhouette_iou(*pose, topology, target)
    depth_map(np.eye(3, dtype=np.float32) + 1, faces, np.eye(3, dtype=np.float32), 8, 8, near=1)
    assert all(len(kernel.signatures) == 1 for kernel in public)
