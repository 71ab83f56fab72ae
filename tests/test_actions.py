"""Action retrieval: pose features, nearest poses, the stage, and the files it reads."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hoi.actions.config import COMPARED_JOINTS, ActionsConfig
from hoi.actions.database import (
    DEFAULT_DATABASE,
    PoseDatabase,
    load_database,
    save_database,
)
from hoi.actions.leave_one_out import (
    accuracy_report,
    accuracy_table,
    leave_one_out,
    stated_probability,
)
from hoi.actions.retrieval import PoseIndex, pelvis_up_in_camera, pose_features, probabilities
from hoi.actions.space import DEFAULT_ACTION_SPACE, load_action_space
from hoi.actions.stage import ActionStage
from hoi.artifacts import BodyFit, Frame, Hints
from hoi.body.skeleton import JOINT
from hoi.errors import AssetError, FrameFailure


@pytest.fixture(scope="module")
def database() -> PoseDatabase:
    return load_database(DEFAULT_DATABASE)


@pytest.fixture(scope="module")
def stage() -> ActionStage:
    return ActionStage(ActionsConfig(), DEFAULT_DATABASE, DEFAULT_ACTION_SPACE)


UP = np.array([0.0, 1.0, 0.0])  # an upright pelvis
UPRIGHT = (np.pi, 0.0, 0.0)  # global_orient of an upright person before a level camera


def features_of(database: PoseDatabase, rows: np.ndarray, config: ActionsConfig) -> np.ndarray:
    assert database.pelvis_up is not None
    return pose_features(database.body_pose[rows], config, database.pelvis_up[rows])


def frame_with(category: str, action: str = "") -> Frame:
    return Frame(
        frame_id="f",
        dataset="test",
        category=category,
        action=action,
        image=np.zeros((2, 2, 3), np.uint8),
        intrinsics=np.eye(3),
    )


def body_with(body_pose: np.ndarray, global_orient=UPRIGHT) -> BodyFit:
    return BodyFit(
        frame_id="f",
        global_orient=np.array(global_orient),
        body_pose=body_pose,
        betas=np.zeros(10),
        transl=np.zeros(3),
        vertices=np.zeros((4, 3)),
        joints=np.zeros((24, 3)),
    )


# ------------------------------------------------------------------------------ retrieval


@pytest.mark.parametrize("metric", ["rotation_matrix", "axis_angle"])
@given(seed=st.integers(0, 2**32 - 1))
def test_the_tree_finds_what_brute_force_finds(database, metric, seed):
    config = ActionsConfig(metric=metric)
    query = np.random.default_rng(seed).normal(0, 0.7, 69)
    rows = database.rows_of("chair")
    wanted = pose_features(query[None], config, UP[None])
    distances = np.linalg.norm(features_of(database, rows, config) - wanted, axis=1)
    match = PoseIndex(database, "chair", config).nearest(query, UP)
    assert match.row == rows[np.argmin(distances)]
    assert match.distance == pytest.approx(distances.min())


def test_the_nearest_pose_of_each_action_is_its_minimum_in_order(database):
    query = database.body_pose[3] + 0.05
    index = PoseIndex(database, "chair", ActionsConfig())
    matches = index.nearest_per_action(query, UP)
    rows = database.rows_of("chair")
    wanted = pose_features(query[None], ActionsConfig(), UP[None])
    distances = np.linalg.norm(features_of(database, rows, ActionsConfig()) - wanted, axis=1)
    for action, match in matches.items():
        assert database.actions[match.row] == action
        assert match.distance == pytest.approx(distances[database.actions[rows] == action].min())
    assert [m.distance for m in matches.values()] == sorted(m.distance for m in matches.values())
    assert next(iter(matches.values())) == index.nearest(query, UP)


def test_a_pose_of_the_database_finds_itself(database):
    index = PoseIndex(database, "chair", ActionsConfig())
    for row in database.rows_of("chair")[::37]:
        match = index.nearest(database.body_pose[row], database.pelvis_up[row])
        assert match.row == row
        assert match.distance == pytest.approx(0, abs=1e-9)


@given(st.floats(0.1, 3.0), st.integers(0, 2**32 - 1))
def test_rotation_matrices_do_not_see_the_2_pi_wrap(angle, seed):
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    first, second = np.zeros((2, 69))
    knee = 3 * (JOINT["left_knee"] - 1)
    first[knee : knee + 3] = angle * axis
    second[knee : knee + 3] = (angle - 2 * np.pi) * axis
    both = pose_features(np.stack((first, second)), ActionsConfig(metric="rotation_matrix"))
    assert np.allclose(both[0], both[1], atol=1e-9)
    apart = pose_features(np.stack((first, second)), ActionsConfig(metric="axis_angle"))
    assert np.linalg.norm(apart[0] - apart[1]) == pytest.approx(2 * np.pi)


def test_rotation_matrix_distance_is_that_of_the_angle_between_rotations():
    # |R - S| = 2 sqrt(2) sin(angle / 2) in Frobenius norm, for one joint that differs
    pose = np.zeros((2, 69))
    elbow = 3 * (JOINT["left_elbow"] - 1)
    pose[1, elbow : elbow + 3] = Rotation.from_euler("y", -70, degrees=True).as_rotvec()
    first, second = pose_features(pose, ActionsConfig())
    expected = 2 * np.sqrt(2) * np.sin(np.deg2rad(70) / 2)
    assert np.linalg.norm(first - second) == pytest.approx(expected)


@pytest.mark.parametrize("joint", ["left_wrist", "right_hand", "head", "left_ankle", "right_foot"])
def test_hardly_observed_joints_do_not_count(joint):
    assert joint not in COMPARED_JOINTS
    pose = np.zeros((2, 69))
    pose[1, 3 * (JOINT[joint] - 1)] = 1.0
    first, second = pose_features(pose, ActionsConfig())
    assert np.array_equal(first, second)


# ---------------------------------------------------------------------------------- stage


def test_the_stage_never_sees_the_true_action(stage, database):
    pose = database.body_pose[database.rows_of("chair")[0]]
    answers = {
        stage(frame=frame_with("chair", action=truth), body=body_with(pose)).to_bytes()
        for truth in ("", "sit", "lift", "hand")
    }
    assert len(answers) == 1


@given(st.floats(-np.pi, np.pi))
def test_which_way_a_person_faces_changes_nothing(stage, database, yaw):
    pose = database.body_pose[database.rows_of("chair")[5]]
    facing = Rotation.from_euler("y", yaw) * Rotation.from_rotvec(UPRIGHT)
    first = stage(frame=frame_with("chair"), body=body_with(pose))
    turned = stage(frame=frame_with("chair"), body=body_with(pose, facing.as_rotvec()))
    assert turned.action == first.action and turned.detail == first.detail
    assert turned.distance == pytest.approx(first.distance)


@given(st.floats(-80, 80), st.floats(-180, 180))
def test_the_pelvis_feels_how_far_it_is_pitched(pitch, yaw):
    # a person pitched forward before a level camera sees up tilt backwards
    bent = Rotation.from_euler("YX", [yaw, pitch], degrees=True)
    camera_from_pelvis = Rotation.from_rotvec(UPRIGHT) * bent
    pitch = np.deg2rad(pitch)
    expected = [0, np.cos(pitch), -np.sin(pitch)]
    assert np.allclose(pelvis_up_in_camera(camera_from_pelvis.as_rotvec()), expected)


def test_tilt_tells_a_squat_from_a_seat():
    pose = np.zeros((2, 69))
    database = PoseDatabase(
        np.array(["seat", "squat"]),
        np.array(["chair", "chair"]),
        np.array(["sit", "lift"]),
        pose.astype(np.float32),
        np.array([[0, 1, 0], [0, np.cos(0.8), -np.sin(0.8)]], np.float32),
    )
    index = PoseIndex(database, "chair", ActionsConfig())
    assert index.nearest(pose[0], UP).row == 0
    assert index.nearest(pose[0], np.array([0, np.cos(0.7), -np.sin(0.7)])).row == 1
    # without it, as in the paper, they are the same
    index = PoseIndex(database, "chair", ActionsConfig(tilt_weight=0))
    assert index.nearest(pose[0], UP).distance == 0 == index.nearest(pose[0], -UP).distance


def test_a_database_without_tilt_compares_joints_only(tmp_path, database):
    bare = PoseDatabase(
        database.pose_ids, database.categories, database.actions, database.body_pose
    )
    save_database(bare, tmp_path / "bare.npz")
    stage = ActionStage(ActionsConfig(), tmp_path / "bare.npz", DEFAULT_ACTION_SPACE)
    row = database.rows_of("chair")[0]
    upside_down = body_with(database.body_pose[row], (0, 0, 0))
    action = stage(frame=frame_with("chair"), body=upside_down)
    assert action.distance == pytest.approx(0, abs=1e-9)
    assert action.action == database.actions[row]


def test_runners_up_are_every_other_action_nearest_first(stage, database):
    pose = database.body_pose[database.rows_of("chair")[0]] + 0.02
    action = stage(frame=frame_with("chair"), body=body_with(pose))
    others = [neighbour.action for neighbour in action.runners_up]
    assert sorted([action.action, *others]) == database.actions_of("chair")
    distances = [action.distance, *(neighbour.distance for neighbour in action.runners_up)]
    assert distances == sorted(distances)


def test_the_users_word_goes_before_retrieval_which_comes_next(stage, database):
    body = body_with(database.body_pose[database.rows_of("chair")[0]])
    frame = frame_with("chair")
    found = stage(frame, body)
    other = "sit" if found.action == "lift" else "lift"
    told = frame.model_copy(update={"hints": Hints(action=other)})
    overruled = stage(told, body)
    assert overruled.action == told.hints.action != found.action
    assert overruled.runners_up[0].action == found.action
    assert "the user's word" in overruled.detail
    assert overruled.pose_id == found.pose_id and overruled.pose_distance == found.distance


def test_the_users_word_holds_for_an_object_without_poses(stage, database):
    frame = frame_with("anvil").model_copy(update={"hints": Hints(action="lift")})
    assert stage(frame, body_with(database.body_pose[0])).action == "lift"


def test_only_poses_with_the_frames_object_are_searched(stage, database):
    row = np.flatnonzero(database.pose_ids == "type_seated_00")[0]
    up = database.pelvis_up[row]
    facing = Rotation.from_rotvec(UPRIGHT) * Rotation.from_euler("x", np.arctan2(-up[2], up[1]))
    typing = body_with(database.body_pose[row], facing.as_rotvec())
    with_keyboard = stage(frame=frame_with("keyboard"), body=typing)
    with_chair = stage(frame=frame_with("chair"), body=typing)
    assert with_keyboard.action == "type"
    assert with_keyboard.distance == pytest.approx(0, abs=1e-3)
    assert with_chair.action in database.actions_of("chair")


def test_an_unknown_object_is_a_failure_of_the_frame(stage):
    with pytest.raises(FrameFailure) as failure:
        stage(frame=frame_with("horse"), body=body_with(np.zeros(69)))
    assert failure.value.status == "no_pose_for_object"
    assert "chair" in failure.value.detail


@pytest.mark.parametrize(
    ("category", "action"),
    [("chair", "sit"), ("stool", "rest"), ("table", "place"), ("keyboard", "type"),
     ("suitcase", "carry"), ("backpack", "backpack")],
)  # fmt: skip
def test_the_default_action_is_the_heaviest_edge_that_has_poses(stage, category, action):
    artifact = stage(frame=frame_with(category), body=body_with(np.zeros(69)))
    assert artifact.default_action == action


# ------------------------------------------------------------------------------ the files


def test_a_database_survives_its_file_and_gives_equal_bytes(tmp_path, database):
    save_database(database, tmp_path / "a.npz")
    save_database(load_database(tmp_path / "a.npz"), tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def write_npz(path, **changes):
    arrays = {
        "pose_ids": np.array(["a", "b"]),
        "categories": np.array(["chair", "chair"]),
        "actions": np.array(["sit", "sit"]),
        "body_pose": np.zeros((2, 69), np.float32),
    } | changes
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    return path


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"actions": None}, "lacks actions"),
        ({"body_pose": np.zeros((2, 72), np.float32)}, r"shape \(2, 72\)"),
        ({"body_pose": np.full((2, 69), np.nan)}, "NaN"),
        ({"pose_ids": np.array(["a", "a"])}, "not unique"),
        ({"pelvis_up": np.zeros((2, 3))}, "unit vector"),
        ({"categories": np.array(["chair"])}, "one text per pose"),
        ({"actions": np.array(["sit", None], dtype=object)}, "not a readable"),
    ],
)
def test_a_damaged_database_is_named_with_its_problem(tmp_path, changes, problem):
    path = write_npz(tmp_path / "poses.npz", **changes)
    with pytest.raises(AssetError, match=problem) as error:
        load_database(path)
    assert "poses.npz" in str(error.value)


def test_an_absent_or_truncated_database_says_so(tmp_path):
    with pytest.raises(AssetError, match="build_database"):
        load_database(tmp_path / "none.npz")
    (tmp_path / "half.npz").write_bytes(DEFAULT_DATABASE.read_bytes()[:5000])
    with pytest.raises(AssetError, match=r"half\.npz"):
        load_database(tmp_path / "half.npz")


def test_edges_below_the_weight_are_no_actions():
    everything = load_action_space(DEFAULT_ACTION_SPACE, 1.0)
    strong = load_action_space(DEFAULT_ACTION_SPACE, 3.0)
    assert {"sit", "rest", "sleep", "stand on"} <= set(everything.actions_of("chair"))
    assert list(strong.actions_of("chair")) == ["sit", "rest"]
    assert all(edge.relation in ("UsedFor", "RelatedTo") for edge in everything.edges)


def test_a_bad_edge_is_named_with_its_line(tmp_path):
    path = tmp_path / "actions.tsv"
    header = "category\tnoun\trelation\tphrase\tweight\taction\n"
    path.write_text(header + "chair\tchair\tIsA\tsit\t2\tsit\n")
    with pytest.raises(AssetError, match="line 2: relation 'IsA'"):
        load_action_space(path)
    path.write_text(header + "chair\tchair\tUsedFor\tsit\t\tsit\n")
    with pytest.raises(AssetError, match="line 2: weight is empty"):
        load_action_space(path)
    path.write_text("noun\taction\n")
    with pytest.raises(AssetError, match="columns"):
        load_action_space(path)


# ------------------------------------------------------------------------- leave one out


def test_leave_one_out_counts_every_pose_once_and_never_finds_itself():
    rng = np.random.default_rng(0)
    pose = np.repeat(rng.normal(0, 0.5, (2, 69)), 5, axis=0) + rng.normal(0, 0.01, (10, 69))
    database = PoseDatabase(
        np.array([f"{'ab'[i // 5]}_{i:02d}" for i in range(10)]),
        np.array(["chair"] * 10),
        np.array(["sit"] * 5 + ["lift"] * 5),
        pose.astype(np.float32),
    )
    report = leave_one_out(database, "chair")
    assert report.accuracy == 1.0
    assert report.confusion.to_numpy().sum() == 10
    assert (report.distances > 0).all()
    # without any variant of its base pose only the other action is left: no fair question
    alone = leave_one_out(database, "chair", by="base")
    assert np.isnan(alone.accuracy) and alone.confusion.empty
    assert (database.actions[alone.nearest] != database.actions[alone.rows]).all()


def test_the_database_recognises_its_own_chairs(database):
    assert leave_one_out(database, "chair").accuracy > 0.75


def test_the_accuracy_table_has_a_row_for_each_object_with_a_choice(database):
    rows = np.concatenate([database.rows_of("keyboard"), database.rows_of("trashcan")])
    small = PoseDatabase(
        *(field[rows] for field in (database.pose_ids, database.categories, database.actions)),
        database.body_pose[rows],
    )
    table = accuracy_table(small).set_index("category")
    assert table.loc["keyboard", "actions"] == 2
    assert 0.8 < table.loc["keyboard", "without_the_pose"] <= 1
    assert "trashcan" not in table.index


def test_stated_probabilities_are_about_as_high_as_the_accuracy(database):
    """Poses of descriptions that retrieval has not seen; one temperature for all objects."""
    table = accuracy_report(database).dropna()
    stated, right = table["stated_probability"], table["without_its_base_pose"]
    weights = table["poses"]
    assert np.average(stated, weights=weights) == pytest.approx(
        np.average(right, weights=weights), abs=0.05
    )
    chair = table.set_index("category").loc["chair"]
    assert chair["stated_probability"] == pytest.approx(chair["without_its_base_pose"], abs=0.05)
    sure = ActionsConfig(temperature=1e-3)
    assert stated_probability(database, "chair", sure) > 0.99


def test_probabilities_fall_with_distance_and_sum_to_one():
    shares = probabilities(np.array([1.0, 1.0, 1.7]), temperature=0.35)
    assert shares.sum() == pytest.approx(1)
    assert shares[0] == shares[1]
    assert shares[2] / shares[0] == pytest.approx(np.exp(-2))
