"""Scenes: metres, glTF's axes, names, colours and stable bytes."""

from __future__ import annotations

import hashlib
import io

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import report_synthetic as synthetic
from hoi.artifacts import GroundTruth, Joint
from hoi.report.config import ReportConfig
from hoi.report.scene import (
    Reconstruction,
    body_colours,
    of_joint,
    of_truth,
    scene_from_camera,
    scene_glb,
    write_scene_glb,
    write_scene_meshes,
)

BODY, FACES = synthetic.person()


def loaded(data: bytes):
    return trimesh.load(io.BytesIO(data), file_type="glb")


def placed(scene, name: str) -> np.ndarray:
    transform, geometry = scene.graph[name]
    return trimesh.transform_points(scene.geometry[geometry].vertices, transform)


@pytest.fixture
def reconstruction() -> Reconstruction:
    return of_joint(synthetic.joint(), FACES)


def test_a_glb_names_its_nodes_and_keeps_metres(reconstruction):
    scene = loaded(scene_glb(reconstruction))
    assert set(scene.graph.nodes_geometry) == {"body", "object", "ground"}
    assert "camera" in scene.graph.nodes
    np.testing.assert_allclose(np.ptp(placed(scene, "body"), axis=0), [0.64, 1.7, 0.2], atol=1e-5)
    np.testing.assert_allclose(
        np.ptp(placed(scene, "object"), axis=0), [0.45, 0.9, 0.45], atol=1e-5
    )


def test_a_glb_is_y_up_with_the_photographer_towards_plus_z(reconstruction):
    scene = loaded(scene_glb(reconstruction))
    body, thing = placed(scene, "body"), placed(scene, "object")
    assert body[:, 1].min() == pytest.approx(0, abs=1e-6)  # feet on the ground
    assert body[:, 1].max() == pytest.approx(1.7, abs=1e-5)
    assert placed(scene, "ground")[:, 1] == pytest.approx(0)
    assert thing[:, 0].mean() > body[:, 0].mean()  # right stays right
    assert thing[:, 2].max() > body[:, 2].max()  # the nearer chair has the larger z
    np.testing.assert_allclose((body.min(0) + body.max(0))[[0, 2]], 0, atol=1e-5)


def test_the_extras_lead_back_to_the_camera_frame(reconstruction):
    scene = loaded(scene_glb(reconstruction, description="some frame"))
    back = np.array(scene.metadata["camera_from_scene"])
    assert scene.metadata["description"] == "some frame"
    found = trimesh.transform_points(placed(scene, "body"), back)
    np.testing.assert_allclose(found, reconstruction.body_vertices, atol=1e-5)


def test_the_camera_node_sees_what_the_photo_shows(reconstruction):
    """glTF cameras look along -z with y up: their projection must match OpenCV's."""
    scene = loaded(
        scene_glb(reconstruction, intrinsics=synthetic.INTRINSICS, image_size=(640, 480))
    )
    pose, _ = scene.graph["camera"]
    seen = trimesh.transform_points(placed(scene, "object"), np.linalg.inv(pose))
    gltf = seen[:, :2] / -seen[:, 2:]
    opencv = reconstruction.object_vertices
    opencv = opencv[:, :2] / opencv[:, 2:]
    np.testing.assert_allclose(gltf * [1, -1], opencv, atol=1e-5)
    assert np.radians(scene.camera.fov[1]) == pytest.approx(2 * np.arctan(240 / 500), abs=1e-4)


@given(st.floats(-0.6, 0.6), st.floats(-3, -0.4), st.floats(-0.6, 0.6))
def test_a_tilted_camera_gives_a_level_scene(x, y, z):
    up = np.array([x, y, z])
    scene = Reconstruction(BODY, FACES, *synthetic.chair(), up=up)
    transform = scene_from_camera(scene)
    rotation = transform[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation @ (up / np.linalg.norm(up)), [0, 1, 0], atol=1e-9)
    assert (rotation @ [0, 0, 1])[2] < 0  # the camera still looks towards -z


def test_a_known_ground_height_is_kept():
    scene = Reconstruction(BODY, FACES, *synthetic.chair(), np.array([0, -1.0, 0]), -1.25)
    body = trimesh.transform_points(BODY, scene_from_camera(scene))
    assert body[:, 1].min() == pytest.approx(0.25, abs=1e-6)


def test_a_camera_that_looks_straight_down_is_refused_with_a_reason():
    scene = Reconstruction(BODY, FACES, *synthetic.chair(), np.array([0, 0, -1.0]))
    with pytest.raises(ValueError, match="straight along gravity"):
        scene_from_camera(scene)


def test_skin_reddens_only_near_the_object():
    config = ReportConfig(contact_colour="#ff0000", body_colour="#0000ff")
    colours = body_colours(of_joint(synthetic.joint(x=0.32), FACES), config)  # chair on the arm
    distance = np.maximum(synthetic.chair(0.32)[0][:, 0].min() - BODY[:, 0], 0)
    assert (colours[distance > 0.1] == [0, 0, 255]).all()
    far = body_colours(of_joint(synthetic.joint(x=2.0), FACES), config)
    assert (far == [0, 0, 255]).all()
    touching, faces = synthetic.boxes(((0.32, -0.5, 2.8), (0.7, 0.3, 3.2)))
    joint = synthetic.joint().model_copy(update=dict(object_vertices=touching, object_faces=faces))
    near = body_colours(of_joint(joint, FACES), config)
    np.testing.assert_allclose(near[np.isclose(BODY[:, 0], 0.32)], [[255, 0, 0]] * 4, atol=1e-3)


def test_vertex_colours_are_written_in_linear_light(reconstruction):
    config = ReportConfig(object_colour="#bcbcbc")  # 188 of 255 is half the light
    scene = loaded(scene_glb(reconstruction, config))
    colours = scene.geometry["object"].visual.vertex_attributes["color"]
    np.testing.assert_array_equal(np.asarray(colours)[:, :3], 128)


def test_compact_scenes_are_smaller_and_within_their_precision(reconstruction):
    config = ReportConfig()
    exact, compact = (scene_glb(reconstruction, config, compact=c) for c in (False, True))
    assert len(compact) < len(exact)
    difference = placed(loaded(exact), "body") - placed(loaded(compact), "body")
    assert np.abs(difference).max() <= config.scene_precision_m


def test_equal_scenes_give_equal_bytes(reconstruction, tmp_path):
    digests = set()
    for name in ("a.glb", "b.glb"):
        write_scene_glb(tmp_path / "deep" / name, synthetic.joint(), FACES)
        digests.add(hashlib.sha256((tmp_path / "deep" / name).read_bytes()).hexdigest())
    assert len(digests) == 1


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_other_formats_hold_the_same_scene(suffix, tmp_path, reconstruction):
    path = tmp_path / f"scene{suffix}"
    write_scene_meshes(path, synthetic.joint(), FACES)
    mesh = trimesh.load(path, force="mesh", process=False)
    scene = loaded(scene_glb(reconstruction))
    both = np.concatenate([placed(scene, "body"), placed(scene, "object")])
    np.testing.assert_allclose(mesh.bounds, [both.min(0), both.max(0)], atol=2e-5)
    assert len(mesh.faces) == len(FACES) + len(synthetic.chair()[1])


def test_an_obj_keeps_body_and_object_apart(tmp_path):
    write_scene_meshes(tmp_path / "scene.obj", synthetic.joint(), FACES)
    text = (tmp_path / "scene.obj").read_text()
    assert text.index("o body") < text.index("o object")


def test_an_unknown_format_is_refused_by_name(tmp_path):
    with pytest.raises(ValueError, match=r"\.obj or \.ply"):
        write_scene_meshes(tmp_path / "scene.fbx", synthetic.joint(), FACES)


def test_a_failed_frame_has_no_scene_and_says_why():
    failure = synthetic.failed(Joint, "diverged", "", "joint")
    with pytest.raises(ValueError, match="diverged"):
        of_joint(failure, FACES)
    with pytest.raises(ValueError, match="no_truth"):
        of_truth(synthetic.failed(GroundTruth, "no_truth", "", "frame"))
