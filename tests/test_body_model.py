"""The body model against an independent skinning, and its kinematics against autograd."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hoi.body import DEFAULT_BODY, BodyModel
from hoi.body.files import BodyFile, read_body_file
from hoi.body.jacobian import KeypointKinematics, left_jacobian
from hoi.body.keypoints import (
    FROM_BLAZEPOSE33,
    FROM_BODY25,
    FROM_COCO17,
    KEYPOINT,
    KEYPOINTS,
    SURFACE_KEYPOINTS,
    convert_keypoints,
    derive_surface_regressor,
)
from hoi.body.parts import REGIONS, part_vertices
from hoi.body.skeleton import JOINT, JOINT_NAMES, MIRROR, PARENTS, mirror_pose
from hoi.geometry import axis_angle_to_matrix


@pytest.fixture(scope="module")
def body_file() -> BodyFile:
    return read_body_file(DEFAULT_BODY)


@pytest.fixture(scope="module")
def model() -> BodyModel:
    return BodyModel.load(DEFAULT_BODY, dtype=torch.float64)


@pytest.fixture(scope="module")
def corrective_file(body_file) -> BodyFile:
    """The embedded body with made-up pose blend shapes, which it has none of."""
    noise = np.random.default_rng(0).normal(0, 0.002, body_file.posedirs.shape)
    return BodyFile(**{**vars(body_file), "posedirs": noise})


def random_parameters(seed: int, batch: int = 2, spread: float = 0.6):
    random = np.random.default_rng(seed)
    shapes = ((batch, 3), (batch, 69), (batch, 10), (batch, 3))
    return tuple(torch.as_tensor(random.normal(0, spread, shape)) for shape in shapes)


def skin_one_vertex_at_a_time(data: BodyFile, global_orient, body_pose, betas, transl):
    """The textbook definition in numpy: 4x4 matrices down the chain, vertex by vertex."""
    shaped = data.v_template + data.shapedirs[..., : len(betas)] @ betas
    rest = data.joint_regressor @ shaped
    rotations = Rotation.from_rotvec(np.r_[global_orient, body_pose].reshape(24, 3)).as_matrix()
    shaped = shaped + data.posedirs @ (rotations[1:] - np.eye(3)).ravel()
    world = []
    for joint, parent in enumerate(PARENTS):
        step = np.eye(4)
        step[:3, :3] = rotations[joint]
        step[:3, 3] = rest[joint] - (rest[parent] if parent >= 0 else 0)
        world.append(step if parent < 0 else world[parent] @ step)
    to_rest = np.tile(np.eye(4), (24, 1, 1))
    to_rest[:, :3, 3] = -rest
    relative = np.stack([a @ b for a, b in zip(world, to_rest, strict=True)])
    vertices = np.empty_like(shaped)
    for index, vertex in enumerate(shaped):
        matrix = np.tensordot(data.weights[index], relative, axes=1)
        vertices[index] = (matrix @ np.r_[vertex, 1.0])[:3]
    return vertices + transl, np.stack(world)[:, :3, 3] + transl


@pytest.mark.parametrize("seed", range(3))
def test_skinning_equals_the_textbook_definition_with_pose_correctives(corrective_file, seed):
    parameters = random_parameters(seed, batch=2)
    vertices, joints = BodyModel(corrective_file, dtype=torch.float64)(*parameters)
    for row in range(2):
        expected = skin_one_vertex_at_a_time(corrective_file, *(p[row].numpy() for p in parameters))
        np.testing.assert_allclose(vertices[row].numpy(), expected[0], atol=1e-9)
        np.testing.assert_allclose(joints[row].numpy(), expected[1], atol=1e-9)


def test_single_precision_is_good_to_a_hundredth_of_a_millimetre(body_file):
    parameters = random_parameters(5)
    single = BodyModel(body_file)(*(p.float() for p in parameters)).vertices
    double = BodyModel(body_file, dtype=torch.float64)(*parameters).vertices
    assert (single - double).abs().max() < 1e-5


def test_joints_and_keypoints_alone_equal_those_of_the_whole_body(corrective_file):
    model = BodyModel(corrective_file, dtype=torch.float64)
    parameters = random_parameters(1, batch=4)
    vertices, joints = model(*parameters)
    torch.testing.assert_close(model.joints(*parameters), joints)
    keypoints = model.keypoints(*parameters)
    on_skin = torch.as_tensor(corrective_file.keypoint_regressor) @ vertices
    for row, name in enumerate(SURFACE_KEYPOINTS):
        torch.testing.assert_close(keypoints[:, KEYPOINT[name]], on_skin[:, row])
    torch.testing.assert_close(keypoints[:, KEYPOINT["left_knee"]], joints[:, JOINT["left_knee"]])


def test_zero_parameters_give_the_template(model, body_file):
    zeros = (torch.zeros(1, n, dtype=torch.float64) for n in (3, 69, 10))
    vertices, joints = model(*zeros)
    np.testing.assert_allclose(vertices[0].numpy(), body_file.v_template, atol=1e-12)
    np.testing.assert_allclose(joints[0].numpy(), model.template_joints, atol=1e-12)


def test_global_orientation_turns_the_body_about_its_pelvis(model):
    orient, pose, betas, transl = random_parameters(2)
    upright = model(torch.zeros_like(orient), pose, betas, transl)
    turned = model(orient, pose, betas, transl)
    rotation = axis_angle_to_matrix(orient)
    pelvis = upright.joints[:, :1]
    expected = (upright.vertices - pelvis) @ rotation.transpose(1, 2) + pelvis
    torch.testing.assert_close(turned.vertices, expected)


def test_mirrored_pose_gives_the_mirrored_skeleton(model):
    _, pose, _, _ = random_parameters(3, batch=1)
    zeros = [torch.zeros(1, n, dtype=torch.float64) for n in (3, 10)]
    joints = model.joints(zeros[0], pose, zeros[1])[0].numpy()
    mirrored = model.joints(zeros[0], torch.as_tensor(mirror_pose(pose.numpy())), zeros[1])
    expected = (joints * [-1, 1, 1])[list(MIRROR)]
    # the embedded skeleton is symmetric to a few millimetres
    np.testing.assert_allclose(mirrored[0].numpy(), expected, atol=0.01)


def test_wrong_parameter_shapes_are_refused(model):
    zeros = torch.zeros(1, 69, dtype=torch.float64)
    with pytest.raises(ValueError, match="body_pose"):
        model(zeros[:, :3], zeros[:, :63], zeros[:, :10])
    with pytest.raises(ValueError, match="betas"):
        model(zeros[:, :3], zeros, zeros[:, :7])


def test_equal_files_have_equal_identities_and_other_bodies_do_not(body_file):
    other = BodyFile(**{**vars(body_file), "v_template": body_file.v_template * 1.01})
    assert BodyModel(body_file).identity == BodyModel(body_file, num_betas=4).identity
    assert BodyModel(body_file).identity != BodyModel(other).identity


# ----------------------------------------------------------------------- the embedded body


def test_embedded_body_is_a_closed_adult_facing_front(body_file):
    import trimesh

    mesh = trimesh.Trimesh(body_file.v_template, body_file.faces, process=False)
    assert mesh.is_watertight
    assert 0.05 < mesh.volume < 0.09  # positive: faces are counter-clockwise from outside
    assert 1.6 < np.ptp(body_file.v_template[:, 1]) < 1.75
    assert len(body_file.v_template) != 6890, "vertices must never match SMPL's by index"
    assert (np.count_nonzero(body_file.weights, axis=1) <= 4).all()
    np.testing.assert_allclose(body_file.joint_regressor.sum(1), 1, atol=1e-5)


def test_embedded_keypoints_lie_where_their_names_say(model):
    zeros = (torch.zeros(1, n, dtype=torch.float64) for n in (3, 69, 10))
    at = dict(zip(KEYPOINTS, model.keypoints(*zeros)[0].numpy(), strict=True))
    for name, point in at.items():
        if "_" in name:
            assert (point[0] > 0) == name.startswith("left"), name
    assert at["nose"][2] > at["left_eye"][2] > at["left_ear"][2]
    assert at["left_eye"][1] > at["nose"][1]
    assert at["left_ear"][0] > at["left_eye"][0]
    assert at["left_toe"][2] > at["left_ankle"][2] > at["left_heel"][2]
    assert at["left_heel"][1] < at["left_ankle"][1] < at["left_knee"][1] < at["left_hip"][1]


def test_keypoints_derived_from_shape_agree_with_the_stored_ones(body_file):
    joints = body_file.joint_regressor @ body_file.v_template
    derived = derive_surface_regressor(body_file.v_template, body_file.weights, joints)
    gap = (derived - body_file.keypoint_regressor) @ body_file.v_template
    assert np.linalg.norm(gap, axis=1).max() < 0.02


def test_parts_cover_their_side_and_face_their_way(model):
    from hoi.body.parts import vertex_normals

    parts = part_vertices(model)
    assert set(parts) == set(REGIONS)
    vertices, normals = model.v_template, vertex_normals(model.v_template, model.faces)
    for name, indices in parts.items():
        assert len(indices) > 20, name
        assert (np.diff(indices) > 0).all(), name
        side = np.sign(vertices[indices, 0])
        if name.startswith("left_"):
            assert (side > 0).mean() > 0.97, name
        if name.startswith("right_"):
            assert (side < 0).mean() > 0.97, name
    assert normals[parts["back"], 2].max() < 0 < normals[parts["chest"], 2].min()
    assert vertices[parts["butt"], 2].max() < vertices[parts["lap"], 2].max()
    assert normals[parts["shoulders"], 1].min() > 0
    assert vertices[parts["mouth"], 1].mean() < vertices[parts["head"], 1].mean()
    assert set(parts["left_forearm"]) < set(parts["left_arm"])
    assert set(parts["left_thigh"]) < set(parts["left_leg"])
    assert len(parts["body"]) == model.num_vertices


def test_left_and_right_parts_mirror_each_other(model):
    parts = part_vertices(model)
    for name in ("hand", "foot", "leg", "forearm", "thigh", "arm"):
        left, right = (model.v_template[parts[f"{s}_{name}"]] for s in ("left", "right"))
        np.testing.assert_allclose(left.min(0), (right * [-1, 1, 1]).min(0), atol=0.03)
        np.testing.assert_allclose(left.max(0), (right * [-1, 1, 1]).max(0), atol=0.03)


# ------------------------------------------------------------------------------- keypoints

BODY25_NAMES = """
    nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist
    mid_hip right_hip right_knee right_ankle left_hip left_knee left_ankle right_eye left_eye
    right_ear left_ear left_toe left_small_toe left_heel right_toe right_small_toe right_heel
"""
BLAZEPOSE_NAMES = """
    nose left_eye_inner left_eye left_eye_outer right_eye_inner right_eye right_eye_outer
    left_ear right_ear mouth_left mouth_right left_shoulder right_shoulder left_elbow
    right_elbow left_wrist right_wrist left_pinky right_pinky left_index right_index
    left_thumb right_thumb left_hip right_hip left_knee right_knee left_ankle right_ankle
    left_heel right_heel left_toe right_toe
"""


@pytest.mark.parametrize(
    ("names", "index_map"),
    [(BODY25_NAMES, FROM_BODY25), (BLAZEPOSE_NAMES, FROM_BLAZEPOSE33)],
)
def test_detector_orders_map_to_ours(names, index_map):
    order = names.split()
    assert [order[index] for index in index_map] == list(KEYPOINTS)


def test_coco_has_all_but_the_feet():
    assert list(FROM_COCO17) == [*range(17), -1, -1, -1, -1]


def test_a_keypoint_the_detector_lacks_has_no_confidence():
    converted = convert_keypoints(np.ones((17, 3)), FROM_COCO17)
    assert converted.shape == (21, 3)
    assert converted[:17].all() and not converted[17:].any()


# ---------------------------------------------------------------------------- kinematics


def test_closed_form_derivatives_equal_automatic_ones(model):
    kinematics = KeypointKinematics(model)
    orient, pose, betas, _ = random_parameters(4, batch=1)
    root = axis_angle_to_matrix(orient)
    posed = kinematics(root, pose, betas)
    torch.testing.assert_close(posed.keypoints, model.keypoints(orient, pose, betas))

    def keypoints(turn, pose, betas):
        return model_keypoints(model, axis_angle_to_matrix(turn) @ root, pose, betas)

    zero = torch.zeros(1, 3, dtype=torch.float64)
    columns = torch.autograd.functional.jacobian(keypoints, (zero, pose, betas))
    expected = torch.cat([column[:, :, 0] for column in columns], dim=-1)
    torch.testing.assert_close(posed.derivative[0], expected)


def model_keypoints(model, root, pose, betas):
    """Keypoints for a root given as a matrix, by way of a body without its root's rotation."""
    zero = torch.zeros(1, 3, dtype=torch.float64)
    upright = model.keypoints(zero, pose, betas)[0]
    pelvis = model.joints(zero, pose, betas)[0, :1]
    return (upright - pelvis) @ root[0].T + pelvis


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6))
def test_left_jacobian_is_the_derivative_of_the_exponential(numbers):
    vector, direction = torch.tensor(numbers, dtype=torch.float64).view(2, 3)
    step = 1e-6
    moved = axis_angle_to_matrix(vector + step * direction) @ axis_angle_to_matrix(vector).T
    turn = torch.stack([moved[2, 1], moved[0, 2], moved[1, 0]]) / step
    torch.testing.assert_close(turn, left_jacobian(vector) @ direction, atol=1e-4, rtol=1e-4)


def test_parents_come_before_their_children():
    assert all(parent < joint for joint, parent in enumerate(PARENTS))
    assert len(JOINT_NAMES) == len(PARENTS) == 24
