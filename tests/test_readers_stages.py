"""The stages take what other systems found: instances, people, bodies, contacts per vertex."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from hoi.artifacts import Detection, Frame, Instance
from hoi.body import DEFAULT_BODY, BodyModel
from hoi.body.keypoints import KEYPOINT
from hoi.config import load_config, read_config
from hoi.detect import DetectConfig
from hoi.detect.stage import DetectionFailure, DetectStage
from hoi.errors import ConfigError, FrameFailure
from hoi.exemplars import save_library
from hoi.joint.contact_patches import contact_patches
from hoi.joint.stage import JointStage
from hoi.smplify.config import SmplifyConfig
from hoi.smplify.stage import SmplifyStage
from joint_scene import body_model, body_regions, box_chair, method_config, sitting_scene
from other_systems import HEIGHT, WIDTH, block
from test_smplify import KINECT, POSES, aligned_vertex_error

PERSON, PASSER_BY = block(5, 3, 30, 44), block(56, 2, 62, 40)
CHAIR, TABLE = block(25, 20, 50, 46), block(10, 30, 60, 47)
DETECT = DetectConfig(landmarks="none")


def keypoints_in(mask, confidence=0.9):
    rows, columns = np.nonzero(mask)
    chosen = np.linspace(0, len(rows) - 1, 21).astype(int)
    return np.column_stack([columns[chosen] + 0.5, rows[chosen] + 0.5, np.full(21, confidence)])


def frame(*instances, people=(PASSER_BY, PERSON), **changes):
    values = dict(
        frame_id="f",
        category="chair",
        image=np.zeros((HEIGHT, WIDTH, 3), np.uint8),
        intrinsics=np.eye(3),
        given_instances=[Instance(label=label, score=score) for label, score, _ in instances],
        given_instance_masks=np.stack([mask for _, _, mask in instances]),
        given_people=np.stack([keypoints_in(mask) for mask in people]),
        given_by={"masks": "coco_json"},
    )
    return Frame(**(values | changes))


# -------------------------------------------------------------------------------------- detect


def test_person_object_and_keypoints_are_chosen_among_the_given_ones():
    seen = frame(
        ("dining table", 0.99, TABLE),
        ("person", 0.8, PASSER_BY),
        ("person", 0.9, PERSON),
        ("chair", 0.6, CHAIR),
    )
    found = DetectStage(DETECT)(seen, seed=0)
    np.testing.assert_array_equal(found.person_mask, PERSON)
    np.testing.assert_array_equal(found.object_mask, CHAIR)
    np.testing.assert_allclose(found.keypoints, keypoints_in(PERSON), atol=1e-5)
    assert [c.verdict for c in found.candidates if c.label == "chair"] == ["chosen"]
    assert found.object_label == "chair"


def test_a_frame_without_the_object_among_the_instances_says_so_with_what_was_seen():
    with pytest.raises(DetectionFailure) as caught:
        DetectStage(DETECT)(frame(("person", 0.9, PERSON), ("dining table", 0.9, TABLE)), seed=0)
    assert caught.value.status == "no_object_detected"
    assert {c.label for c in caught.value.artifact.candidates} == {"person", "dining table"}


def test_people_without_keypoints_and_masks_of_another_size_fail_the_frame():
    pair = (("person", 0.9, PERSON), ("chair", 0.9, CHAIR))
    nobody = frame(*pair, given_people=np.zeros((0, 21, 3)))
    with pytest.raises(FrameFailure, match="no_keypoints: the keypoint file"):
        DetectStage(DETECT)(nobody, seed=0)
    small = frame(*pair, given_instance_masks=np.ones((2, 5, 5), bool))
    with pytest.raises(FrameFailure, match="mask_size_mismatch"):
        DetectStage(DETECT)(small, seed=0)


# ------------------------------------------------------------------------------------- smplify


@pytest.fixture(scope="module")
def true_body():
    """A pose that is in no database, facing the camera, its vertices and exact keypoints."""
    from hoi.geometry import project

    model = BodyModel.load(DEFAULT_BODY, dtype=torch.float64)
    pose = POSES["reach"].copy()
    pose[1:] += np.random.default_rng(5).normal(0, 0.15, (23, 3))
    pose[22:] = 0
    facing = Rotation.from_euler("x", np.pi) * Rotation.from_euler("y", 0.4)
    pose[0] = facing.as_rotvec()
    parameters = [pose[0], pose[1:].ravel(), np.zeros(model.num_betas), np.array([0.2, 0.1, 2.6])]
    tensors = [torch.as_tensor(p)[None] for p in parameters]
    points = model.keypoints(*tensors)[0].numpy()
    keypoints = np.column_stack([project(points, KINECT), np.ones(21)])
    return pose, model(*tensors).vertices[0].numpy(), keypoints


@pytest.fixture(scope="module")
def standing_database(tmp_path_factory):
    path = tmp_path_factory.mktemp("poses") / "database.npz"
    np.savez(
        path,
        pose_ids=["stand"],
        categories=["chair"],
        actions=["stand"],
        body_pose=POSES["stand"][1:].reshape(1, 69),
    )
    return path


def fitted(database, true_body, given, poses):
    empty = np.zeros((4, 4), bool)
    seen = Frame(
        frame_id="f",
        category="chair",
        image=np.zeros((4, 4, 3), np.uint8),
        intrinsics=KINECT,
        given_poses=poses,
        given_betas=None if poses is None else np.ones((len(poses), 10)),
        given_by={"bodies": "pare"},
    )
    detection = Detection(
        frame_id="f",
        person_box=np.zeros(4),
        object_box=np.zeros(4),
        person_mask=empty,
        object_mask=empty,
        keypoints=true_body[2],
    )
    config = SmplifyConfig(given=given, start_poses=1, start_yaws=4, flip_rounds=0)
    return SmplifyStage(config, DEFAULT_BODY, database)(frame=seen, detection=detection)


def test_the_fit_starts_from_given_bodies_and_ends_nearer_than_without(
    standing_database, true_body
):
    pose, vertices, _ = true_body
    wrong = POSES["overhead"].copy()
    wrong[0] = pose[0]
    poses = np.stack([wrong, pose + 0.05])
    alone = fitted(standing_database, true_body, "start", None)
    both = fitted(standing_database, true_body, "start", poses)
    only = fitted(standing_database, true_body, "only_start", poses)
    assert only.initialisation == "given:pare-1"
    assert not alone.initialisation.startswith("given")
    errors = [aligned_vertex_error(body.vertices, vertices) for body in (only, both, alone)]
    assert errors[0] <= errors[1] <= errors[2] and errors[0] < errors[2], errors


def test_a_given_result_keeps_its_joints_and_is_put_where_the_keypoints_are(
    standing_database, true_body
):
    pose, vertices, _ = true_body
    turned = pose.copy()
    turned[0] = (Rotation.from_euler("y", 0.1) * Rotation.from_rotvec(pose[0])).as_rotvec()
    result = fitted(standing_database, true_body, "result", turned[None])
    np.testing.assert_allclose(result.body_pose, pose[1:].ravel(), atol=1e-9)
    assert not result.betas.any()  # SMPL's shapes mean nothing to the embedded body
    assert np.linalg.norm(result.vertices - vertices, axis=1).mean() < 0.02
    assert result.initialisation == "given:pare-0, kept"


# --------------------------------------------------------------------------------------- joint


def touching_seat():
    """What a perfect contact estimator says of the sitting scene: butt and back touch."""
    contact = np.zeros(body_model().num_vertices, np.float32)
    for region, probability in (("butt", 0.9), ("back", 0.7)):
        contact[body_regions().vertices[region]] = probability
    return contact


def joint(scene, folder, **changes):
    save_library([box_chair()], folder / "chair.npz")
    fast = {"optimiser": "lbfgs", "iterations": 25, "learning_rate": 1e-2, "depth_grid": 15}
    config = method_config("ours", contact="vertices", fast=fast, **changes)
    stage = JointStage(config, DEFAULT_BODY, folder)
    return stage(scene.frame, scene.detection, scene.body, scene.objects, scene.prior, seed=0)


def with_contacts(scene, contact):
    scene.frame = scene.frame.model_copy(update={"given_contacts": contact})
    return scene


def test_contacts_per_vertex_place_the_object_without_any_interaction_map(tmp_path):
    scene = with_contacts(sitting_scene(), touching_seat())
    scene.prior = scene.prior.model_copy(
        update={"retrieved": scene.prior.retrieved.model_copy(update={"contacts": []})}
    )
    scene.objects = scene.objects.model_copy(
        update={"translations": scene.objects.translations * 1.25}
    )
    result = joint(scene, tmp_path)
    error = np.linalg.norm(result.object_vertices - scene.true_vertices, axis=1).mean()
    assert error < 0.12
    assert np.isfinite(result.loss_curve["contact"]).all()
    assert result.loss_curve["contact"][0] != 0


def test_contacts_of_another_body_or_none_fail_the_frame(tmp_path):
    with pytest.raises(FrameFailure, match="contact_size_mismatch: the contacts are of 6890"):
        joint(with_contacts(sitting_scene(), np.zeros(6890, np.float32)), tmp_path)
    with pytest.raises(FrameFailure, match=r"no_given_contacts.*other_systems"):
        joint(sitting_scene(), tmp_path)


def test_a_body_that_touches_nowhere_is_placed_without_contact(tmp_path):
    nothing = np.zeros(body_model().num_vertices, np.float32)
    result = joint(with_contacts(sitting_scene(), nothing), tmp_path)
    assert "no vertex reaches contact 0.5" in result.detail


def test_patches_are_connected_surfaces_largest_first():
    # two strips of triangles that share no vertex
    faces = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4], [5, 6, 7], [6, 7, 8], [8, 9, 10]])
    contact = np.array([1, 1, 1, 1, 1, 0.6, 0.6, 0.6, 0.6, 0.1, 0.1])
    patches = contact_patches(contact, faces, threshold=0.5, most=5)
    assert [len(patch) for patch, _ in patches] == [3, 2]
    assert [probability for _, probability in patches] == pytest.approx([1.0, 0.6])
    assert len(contact_patches(contact, faces, threshold=0.5, most=1)) == 1
    assert contact_patches(contact, faces, threshold=1.1, most=5) == []


def test_contacts_and_the_method_that_takes_them_need_each_other():
    from pathlib import Path

    plain = load_config(Path(__file__).parents[1] / "config" / "config.yaml")
    values = plain.model_dump()
    values["other_systems"] = {"photos": {"contacts": {"path": "{stem}.npz"}}}
    with pytest.raises(ConfigError, match="no method takes them"):
        read_config(values)
    values["methods"]["ours"]["joint"]["contact"] = "vertices"
    assert read_config(values).joint_settings("ours").contact == "vertices"
    values["other_systems"] = {}
    with pytest.raises(ConfigError, match="needs their files"):
        read_config(values)


def test_feet_of_the_chosen_person_are_kept():
    people = np.stack([keypoints_in(PASSER_BY), keypoints_in(PERSON)])
    people[1, KEYPOINT["left_toe"], 2] = 0.33
    seen = frame(("person", 0.9, PERSON), ("chair", 0.9, CHAIR), given_people=people)
    found = DetectStage(DETECT)(seen, seed=0)
    assert found.keypoints[KEYPOINT["left_toe"], 2] == pytest.approx(0.33)
