"""The body fit: accuracy on bodies projected into a Kinect's image, and what it refuses."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hoi.artifacts import Detection, Frame
from hoi.body import DEFAULT_BODY, BodyModel
from hoi.body.jacobian import KeypointKinematics
from hoi.body.keypoints import KEYPOINT
from hoi.body.skeleton import JOINT, mirror_pose
from hoi.errors import AssetError, FrameFailure
from hoi.geometry import axis_angle_to_matrix, project, similarity_procrustes
from hoi.smplify.config import SmplifyConfig
from hoi.smplify.energy import Bodies, Energy, Observation
from hoi.smplify.limbs import depth_flips, pose_from_points
from hoi.smplify.prior import PosePrior, joint_ranges, most_different, read_pose_database
from hoi.smplify.solver import minimise
from hoi.smplify.stage import SmplifyStage
from hoi.smplify.starts import solve_translation

KINECT = np.array([[979.784, 0, 1018.952], [0, 979.840, 779.486], [0, 0, 1]])
DOUBLE = torch.float64
ARMS = [JOINT[f"{s}_{j}"] for s in ("left", "right") for j in ("collar", "shoulder", "elbow")]


def pose(**rotations) -> np.ndarray:
    """A (24, 3) pose; `both_knee` sets the left knee and its mirror image."""
    result = np.zeros((24, 3))
    for name, angles in rotations.items():
        if name.startswith("both_"):
            result[JOINT[f"left_{name[5:]}"]] = angles
            result[JOINT[f"right_{name[5:]}"]] = np.multiply(angles, [1, -1, -1])
        else:
            result[JOINT[name]] = angles
    return result


SIT = dict(both_hip=[-1.5, 0.1, 0.15], both_knee=[1.5, 0, 0])
POSES = {
    "stand": pose(both_shoulder=[0, 0, -1.25], both_elbow=[0, -0.25, 0]),
    "sit": pose(**SIT, both_shoulder=[0, -0.35, -1.1], both_elbow=[0, -1, 0]),
    "reach": pose(**SIT, both_shoulder=[0, -1, -0.6], both_elbow=[0, -0.5, 0], spine1=[0.2, 0, 0]),
    "carry": pose(both_shoulder=[0, -0.9, -1.0], both_elbow=[0, -1.1, 0]),
    "lift": pose(
        pelvis=[0.6, 0, 0],
        both_hip=[-1.4, 0, 0.15],
        both_knee=[1.3, 0, 0],
        both_ankle=[-0.45, 0, 0],
        both_shoulder=[0, -1.2, -0.75],
        spine2=[0.25, 0, 0],
        head=[-0.4, 0, 0],
    ),
    "overhead": pose(both_shoulder=[0, -0.3, 1.2], both_elbow=[0, -0.3, 0]),
    "type": pose(**SIT, both_shoulder=[0, -0.5, -1.15], both_elbow=[0, -1.45, 0]),
}


@pytest.fixture(scope="module")
def model() -> BodyModel:
    return BodyModel.load(DEFAULT_BODY, dtype=DOUBLE)


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    path = tmp_path_factory.mktemp("poses") / "database.npz"
    np.savez(
        path,
        pose_ids=list(POSES),
        categories=["chair"] * len(POSES),
        actions=list(POSES),
        body_pose=np.stack([p[1:].ravel() for p in POSES.values()]),
    )
    return path


@pytest.fixture(scope="module")
def stage(database) -> SmplifyStage:
    return SmplifyStage(SmplifyConfig(), DEFAULT_BODY, database)


class Person:
    """A random body before the camera: true vertices, and noisy keypoints and landmarks."""

    def __init__(self, random: np.random.Generator, model: BodyModel):
        names = list(POSES)
        rotations = POSES[random.choice(names)].copy()
        if random.random() < 0.5:
            rotations[ARMS] = POSES[random.choice(names)][ARMS]
        noise = random.normal(0, np.deg2rad(7), (24, 3))
        noise[[JOINT["left_hand"], JOINT["right_hand"]]] = 0
        hinges = [JOINT[f"{s}_{j}"] for s in ("left", "right") for j in ("knee", "ankle", "foot")]
        noise[hinges, 1:] *= 0.3
        rotations += noise
        rotations[[JOINT["left_knee"], JOINT["right_knee"]], 0] = np.abs(
            rotations[[JOINT["left_knee"], JOINT["right_knee"]], 0]
        )
        tilt = Rotation.from_euler("zx", [random.normal(0, 0.02), random.uniform(0, 0.28)])
        facing = Rotation.from_euler("yx", [random.uniform(0, 2 * np.pi), np.pi])
        orient = tilt * facing * Rotation.from_rotvec(rotations[0])
        distance = random.uniform(2, 3.5)
        values = (
            orient.as_rotvec(),
            rotations[1:].ravel(),
            random.normal(0, 0.8, 10),
            np.array([random.uniform(-0.2, 0.2) * distance, random.uniform(-0.2, 0.2), distance]),
        )
        self.parameters = tuple(torch.as_tensor(value)[None] for value in values)
        self.vertices = model(*self.parameters).vertices[0].numpy()
        points = model.keypoints(*self.parameters)[0].numpy()
        pixels = project(points, KINECT) + random.normal(0, 5, (21, 2))
        confidence = np.ones(21)
        confidence[random.permutation(21)[: random.integers(0, 5)]] = 0
        self.keypoints = np.column_stack([pixels, confidence])
        hips = points[[KEYPOINT["left_hip"], KEYPOINT["right_hip"]]].mean(0)
        self.landmarks = points - hips + random.normal(0, 0.035, (21, 3))


def fit(stage, keypoints, landmarks=None):
    empty = np.zeros((4, 4), dtype=bool)
    frame = Frame(
        frame_id="f",
        dataset="test",
        category="chair",
        image=np.zeros((4, 4, 3)),
        intrinsics=KINECT,
    )
    detection = Detection(
        frame_id="f",
        person_box=np.zeros(4),
        object_box=np.zeros(4),
        person_mask=empty,
        object_mask=empty,
        keypoints=keypoints,
        landmarks=landmarks,
    )
    return stage(frame=frame, detection=detection, seed=0)


def aligned_vertex_error(fitted, true) -> float:
    """Mean distance of vertices after similarity alignment, metres."""
    source = fitted.astype(np.float64)
    scale, rotation, translation = similarity_procrustes(source, true)
    return float(np.linalg.norm(scale * source @ rotation.T + translation - true, axis=1).mean())


# ------------------------------------------------------------------------------- accuracy


@pytest.mark.parametrize(("with_landmarks", "allowed"), [(True, 0.05), (False, 0.08)])
def test_bodies_seen_by_a_kinect_are_found_within_a_few_centimetres(
    stage, model, with_landmarks, allowed
):
    random = np.random.default_rng(11)
    errors = []
    for _ in range(8):
        person = Person(random, model)
        result = fit(stage, person.keypoints, person.landmarks if with_landmarks else None)
        errors.append(aligned_vertex_error(result.vertices, person.vertices))
        assert result.reprojection_error_px < 12
    print("landmarks" if with_landmarks else "keypoints alone", np.round(errors, 3))
    assert np.mean(errors) < allowed


def test_result_places_the_body_by_its_own_parameters(stage, model):
    person = Person(np.random.default_rng(3), model)
    result = fit(stage, person.keypoints, person.landmarks)
    assert result.body_model == model.identity
    parameters = (result.global_orient, result.body_pose, result.betas, result.transl)
    posed = model(*(torch.as_tensor(p)[None] for p in parameters))
    np.testing.assert_allclose(result.vertices, posed.vertices[0].numpy(), atol=1e-5)
    np.testing.assert_allclose(result.joints, posed.joints[0].numpy(), atol=1e-5)
    assert result.energy["total"] == pytest.approx(
        sum(value for name, value in result.energy.items() if name != "total")
    )


def test_equal_input_gives_equal_bytes(stage, database, model):
    person = Person(np.random.default_rng(4), model)
    first = fit(stage, person.keypoints, person.landmarks).to_bytes()
    fit(stage, Person(np.random.default_rng(5), model).keypoints)
    fresh = SmplifyStage(SmplifyConfig(), DEFAULT_BODY, database)
    assert fit(fresh, person.keypoints, person.landmarks).to_bytes() == first


def test_keypoints_without_confidence_are_ignored(stage, model):
    person = Person(np.random.default_rng(6), model)
    person.keypoints[[3, 9, 15], 2] = 0
    elsewhere = person.keypoints.copy()
    elsewhere[[3, 9, 15], :2] = 1e4
    assert (
        fit(stage, person.keypoints, person.landmarks).to_bytes()
        == fit(stage, elsewhere, person.landmarks).to_bytes()
    )


def test_one_keypoint_on_the_wrong_person_does_little_harm(stage, model):
    person = Person(np.random.default_rng(7), model)
    person.keypoints[KEYPOINT["left_wrist"], :2] += 500
    result = fit(stage, person.keypoints, person.landmarks)
    assert aligned_vertex_error(result.vertices, person.vertices) < 0.08


def test_upper_body_alone_still_gives_a_body(stage, model):
    person = Person(np.random.default_rng(8), model)
    person.keypoints[KEYPOINT["left_knee"] :, 2] = 0
    result = fit(stage, person.keypoints)
    assert np.isfinite(result.vertices).all()
    assert 1 < result.transl[2] < 6


def test_person_of_few_pixels_is_fitted_alike(stage, model):
    """The energy counts lengths, so it does not matter how large the image is."""
    person = Person(np.random.default_rng(9), model)
    result = fit(stage, person.keypoints, person.landmarks)
    small = KINECT.copy()
    small[:2] /= 8
    keypoints = person.keypoints.copy()
    keypoints[:, :2] /= 8
    frame = Frame(
        frame_id="f", dataset="test", category="chair", image=np.zeros((4, 4, 3)), intrinsics=small
    )
    empty = np.zeros((4, 4), dtype=bool)
    detection = Detection(
        frame_id="f",
        person_box=np.zeros(4),
        object_box=np.zeros(4),
        person_mask=empty,
        object_mask=empty,
        keypoints=keypoints,
        landmarks=person.landmarks,
    )
    np.testing.assert_allclose(
        stage(frame=frame, detection=detection, seed=0).vertices, result.vertices, atol=2e-3
    )


def test_landmarks_show_an_arm_that_the_image_hides(stage, model):
    """A raised arm out of the picture: the pose database alone would let it hang."""
    person = Person(np.random.default_rng(1), model)
    random = np.random.default_rng(2)
    person.parameters[1][0] = torch.as_tensor(POSES["overhead"][1:].ravel())
    person.vertices = model(*person.parameters).vertices[0].numpy()
    points = model.keypoints(*person.parameters)[0].numpy()
    pixels = project(points, KINECT) + random.normal(0, 5, (21, 2))
    keypoints = np.column_stack([pixels, np.ones(21)])
    keypoints[[KEYPOINT["left_elbow"], KEYPOINT["left_wrist"]], 2] = 0
    hips = points[[KEYPOINT["left_hip"], KEYPOINT["right_hip"]]].mean(0)
    result = fit(stage, keypoints, points - hips + random.normal(0, 0.035, (21, 3)))
    assert aligned_vertex_error(result.vertices, person.vertices) < 0.05


# -------------------------------------------------------------------------------- refusal


def test_no_keypoints_fail_the_frame(stage):
    with pytest.raises(FrameFailure) as failure:
        fit(stage, np.zeros((21, 3)))
    assert failure.value.status == "no_keypoints"


def test_too_few_keypoints_fail_the_frame(stage, model):
    person = Person(np.random.default_rng(1), model)
    person.keypoints[5:, 2] = 0.01
    with pytest.raises(FrameFailure) as failure:
        fit(stage, person.keypoints)
    assert failure.value.status == "too_few_keypoints"


def test_all_keypoints_in_one_point_give_a_finite_body_or_a_failure(stage):
    result = fit(stage, np.tile([900.0, 700.0, 1.0], (21, 1)))
    assert np.isfinite(result.vertices).all()


@pytest.mark.parametrize(
    "entries",
    [
        {"pose_ids": np.array(["a"])},
        {"pose_ids": np.array(["a"]), "body_pose": np.zeros((2, 69))},
        {"pose_ids": np.array(["a"]), "body_pose": np.zeros((1, 72))},
        {"pose_ids": np.array(["a"]), "body_pose": np.full((1, 69), np.nan)},
        {"pose_ids": np.array([]), "body_pose": np.zeros((0, 69))},
    ],
)
def test_a_damaged_pose_database_is_named(tmp_path, entries):
    np.savez(tmp_path / "poses.npz", **entries)
    with pytest.raises(AssetError, match=r"poses\.npz"):
        read_pose_database(tmp_path / "poses.npz")


def test_an_absent_or_truncated_pose_database_is_named(tmp_path, database):
    path = tmp_path / "poses.npz"
    with pytest.raises(AssetError, match="no such pose database"):
        read_pose_database(path)
    path.write_bytes(database.read_bytes()[:500])
    with pytest.raises(AssetError, match=r"poses\.npz"):
        read_pose_database(path)


def test_unknown_settings_are_refused():
    with pytest.raises(ValueError, match="keypoint_wieght"):
        SmplifyConfig(keypoint_wieght=1.0)  # type: ignore[call-arg]


# --------------------------------------------------------------------------------- energy


@pytest.fixture(scope="module")
def scene(model):
    """An energy with every term switched on, and two bodies away from its minimum."""
    random = np.random.default_rng(21)
    person = Person(random, model)
    observation = Observation(
        intrinsics=torch.as_tensor(KINECT),
        keypoints=torch.as_tensor(person.keypoints[:, :2]),
        confidence=torch.as_tensor(person.keypoints[:, 2]),
        landmarks=torch.as_tensor(person.landmarks),
        landmark_confidence=torch.as_tensor(person.keypoints[:, 2]),
        pixels_per_metre=350.0,
    )
    centres = np.stack([p[1:].ravel() for p in POSES.values()])
    config = SmplifyConfig()
    prior = PosePrior(centres, config)
    energy = Energy(config, KeypointKinematics(model), prior, observation, robust_m=0.3)
    orient, body_pose, betas, transl = (p.repeat(2, 1) for p in person.parameters)
    noise = torch.as_tensor(random.normal(0, 0.1, (2, 69)))
    root = axis_angle_to_matrix(orient + noise[:, :3])
    return energy, Bodies(root, body_pose + noise, betas + noise[:, :10], transl + noise[:, :3])


def test_gradient_of_the_energy_equals_finite_differences(scene):
    energy, bodies = scene
    gradient, matrix = energy.normal_equations(bodies, energy.posed(bodies))
    assert torch.linalg.eigvalsh(matrix).min() > -1e-6
    step = 1e-5
    count, size = gradient.shape
    moves = torch.eye(size, dtype=DOUBLE).repeat(count, 1) * step
    each = bodies.select(torch.arange(count).repeat_interleave(size))
    ahead, behind = (
        torch.stack(list(energy.terms(each.stepped(sign * moves)).values())).sum(0)
        for sign in (1, -1)
    )
    expected = (ahead - behind).view(count, size) / (2 * step) / 2
    torch.testing.assert_close(gradient, expected, rtol=1e-3, atol=1e-2)


def test_the_solver_never_raises_an_energy(scene):
    energy, bodies = scene
    before = torch.stack(list(energy.terms(bodies).values())).sum(0)
    for iterations in (1, 3, 10):
        _, after = minimise(energy, bodies, iterations, initial_damping=1e-2)
        assert (after <= before).all()
    assert (after < 0.5 * before).all()


def test_starts_do_not_influence_one_another(scene):
    energy, bodies = scene
    both, _ = minimise(energy, bodies, 6, initial_damping=1e-2)
    alone, _ = minimise(energy, bodies.select([1]), 6, initial_damping=1e-2)
    torch.testing.assert_close(both.select([1]), alone, rtol=1e-6, atol=1e-8)


# ---------------------------------------------------------------------------------- prior


def test_limits_let_knees_and_elbows_bend_one_way_only():
    lower, upper = (limit.reshape(23, 3) for limit in joint_ranges())
    for side, sign in (("left", -1), ("right", 1)):
        knee, elbow = JOINT[f"{side}_knee"] - 1, JOINT[f"{side}_elbow"] - 1
        assert lower[knee, 0] > -0.1 and upper[knee, 0] > 2.4
        straight, bent = sorted((lower[elbow, 1], upper[elbow, 1]), key=abs)
        assert abs(straight) < 0.1 and np.sign(bent) == sign
    np.testing.assert_allclose(
        np.sort([mirror_pose(lower.ravel()), mirror_pose(upper.ravel())], axis=0),
        [lower.ravel(), upper.ravel()],
    )


def test_authored_poses_are_within_the_limits():
    for name, rotations in POSES.items():
        body_pose = rotations[1:].ravel()
        lower, upper = joint_ranges()
        assert (body_pose >= lower).all() and (body_pose <= upper).all(), name


def test_prior_of_one_pose_is_least_there_and_finite_everywhere():
    centre = POSES["sit"][1:].ravel()
    prior = PosePrior(centre[None], SmplifyConfig())
    poses = torch.as_tensor(np.stack([centre, centre + 0.1, np.full(69, 3.0)]))
    closeness, limits = prior.energies(poses)
    assert closeness[0] == pytest.approx(0, abs=1e-9) and limits[0] == 0
    assert closeness[0] < closeness[1] < closeness[2] < math.inf


def test_most_different_poses_start_at_the_middle_and_spread():
    poses = np.zeros((5, 69))
    poses[:, 0] = [0, 0.1, 1, 0.5, 0.5]
    chosen = list(most_different(poses, 3))
    assert chosen[0] == 3 and set(chosen[1:]) == {0, 2}
    assert len(most_different(np.zeros((4, 69)), 3)) == 1


# --------------------------------------------------------------------------------- starts


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_bone_directions_are_recovered_from_exact_points(model, seed):
    """Limbs rebuilt from 3D points have their bones where the points say."""
    random = np.random.default_rng(seed)
    orient = torch.as_tensor(random.normal(0, 1, (1, 3)))
    rotations = POSES[random.choice(list(POSES))][1:]
    body_pose = torch.as_tensor(rotations.reshape(1, 69) + random.normal(0, 0.15, (1, 69)))
    betas = torch.zeros(1, 10, dtype=DOUBLE)
    zero = torch.zeros(1, 69, dtype=DOUBLE)
    points = model.keypoints(orient, body_pose, betas)
    rest = model.keypoints(zero[:, :3], zero, betas)[0]
    root, rebuilt = pose_from_points(points, rest)
    kinematics = KeypointKinematics(model)
    found = kinematics(root, rebuilt, betas).keypoints
    for start, end in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee")):
        for side in ("left", "right"):
            pair = KEYPOINT[f"{side}_{start}"], KEYPOINT[f"{side}_{end}"]
            wanted, have = (p[0, pair[1]] - p[0, pair[0]] for p in (points, found))
            cosine = torch.nn.functional.cosine_similarity(wanted, have, dim=0)
            # the trunk is only known by its ends, so arms hang on an approximate chest
            assert cosine > 0.97, (side, start)


def test_flipped_limbs_keep_their_image_under_weak_perspective(model):
    person = Person(np.random.default_rng(2), model)
    points = model.keypoints(*person.parameters)[0]
    names, variants = depth_flips(points)
    assert len(names) == len(variants) == 12
    assert len({name.rsplit("_", 1)[0] for name in names}) == 4
    moved = project(variants, KINECT) - project(points, KINECT)
    assert moved.norm(dim=-1).max() < 80  # perspective only; limbs span several hundred pixels
    bones = (KEYPOINT["left_shoulder"], KEYPOINT["left_elbow"])
    lengths = (variants[:, bones[1]] - variants[:, bones[0]]).norm(dim=-1)
    torch.testing.assert_close(lengths, lengths[:1].expand(12))


def test_translation_from_spreads_is_close_to_the_true_one(model):
    person = Person(np.random.default_rng(12), model)
    orient, body_pose, betas, transl = person.parameters
    points = model.keypoints(orient, body_pose, betas)
    pixels = project(points[0] + transl, KINECT)
    solved = solve_translation(points, pixels, torch.ones(21).double(), torch.as_tensor(KINECT))
    assert (solved - transl).abs().max() < 0.15
