"""The authored poses: inverse kinematics, and the database built from the descriptions."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hoi.actions.authoring import Arm, Description, Leg, Trunk, pose_from_description
from hoi.actions.build_database import build_database
from hoi.actions.config import DatabaseConfig
from hoi.actions.database import DEFAULT_DATABASE, load_database
from hoi.body.skeleton import JOINT, PARENTS, mirror_pose

# joints of the average adult in T-pose that matter here, metres from the pelvis
REST = {
    "pelvis": (0, 0, 0), "spine1": (0, 0.112, -0.031), "spine2": (0, 0.221, -0.023),
    "spine3": (0, 0.362, -0.033), "left_collar": (0.023, 0.467, 0.01),
    "left_shoulder": (0.172, 0.466, 0.007), "left_elbow": (0.416, 0.466, 0.007),
    "left_hip": (0.105, -0.011, -0.008), "left_knee": (0.132, -0.403, -0.001),
    "left_ankle": (0.124, -0.813, -0.025),
}  # fmt: skip
PALM = (0.724, 0.466, 0.007)

angle = st.floats(-25, 25)
trunks = st.builds(Trunk, tilt=st.floats(-20, 60), lean=angle, side=angle, twist=angle)
reachable = st.tuples(st.floats(0.0, 0.5), st.floats(0.1, 0.6), st.floats(0.15, 0.35))


def left_points(pose: np.ndarray, tilt: float) -> dict[str, np.ndarray]:
    """Forward kinematics of the left half, joint by joint, in the level frame."""
    vectors = np.concatenate((np.zeros((1, 3)), pose.reshape(23, 3)))
    rotation = {"pelvis": Rotation.from_euler("x", tilt, degrees=True).as_matrix()}
    place = {"pelvis": np.zeros(3)}
    names = {index: name for name, index in JOINT.items()}
    for name in REST:
        if name == "pelvis":
            continue
        parent = names[PARENTS[JOINT[name]]]
        offset = np.subtract(REST[name], REST[parent])
        place[name] = place[parent] + rotation[parent] @ offset
        local = Rotation.from_rotvec(vectors[JOINT[name]]).as_matrix()
        rotation[name] = rotation[parent] @ local
    place["palm"] = place["left_elbow"] + rotation["left_elbow"] @ np.subtract(
        PALM, REST["left_elbow"]
    )
    return place


@given(trunks, reachable)
def test_the_palm_arrives_where_it_was_described(trunk, palm):
    pose = pose_from_description(Description(trunk=trunk, left_arm=Arm(palm)))
    points = left_points(pose, trunk.tilt)
    reach = np.subtract(palm, points["left_shoulder"])
    # an unreachable palm stays on the line from the shoulder, at the arm's length;
    # one inside the shoulder stays where the elbow can still bend to
    length = np.clip(np.linalg.norm(reach), 0.177, 0.985 * 0.552)
    expected = points["left_shoulder"] + reach / np.linalg.norm(reach) * length
    assert np.allclose(points["palm"], expected, atol=1e-6)


@given(trunks, reachable)
def test_a_mirrored_description_gives_the_mirrored_pose(trunk, palm):
    leg = Leg(flex=40, abduct=8, splay=6, twist=5, knee=60)
    first = Description(trunk=trunk, left_leg=leg, left_arm=Arm(palm))
    flipped = replace(trunk, side=-trunk.side, twist=-trunk.twist)
    second = Description(trunk=flipped, right_leg=leg, right_arm=Arm(palm))
    ours = Rotation.from_rotvec(mirror_pose(pose_from_description(first)).reshape(-1, 3))
    theirs = Rotation.from_rotvec(pose_from_description(second).reshape(-1, 3))
    assert np.allclose(ours.as_matrix(), theirs.as_matrix(), atol=1e-7)


@given(st.floats(0, 100), st.floats(-20, 60), st.floats(0, 120))
def test_thighs_point_where_described_whatever_the_pelvis_does(flex, tilt, knee):
    leg = Leg(flex=flex, abduct=0, knee=knee)
    pose = pose_from_description(Description(trunk=Trunk(tilt=tilt), left_leg=leg))
    points = left_points(pose, tilt)
    thigh = points["left_knee"] - points["left_hip"]
    rest = np.subtract(REST["left_knee"], REST["left_hip"])
    expected = Rotation.from_euler("x", -flex, degrees=True).apply(rest)
    assert np.allclose(thigh, expected, atol=1e-9)


def test_bending_has_the_signs_of_smpl():
    arm = Arm((0.2, 0.2, 0.3))
    leg = Leg(flex=90, knee=90)
    description = Description(left_arm=arm, right_arm=arm, left_leg=leg, right_leg=leg)
    pose = pose_from_description(description).reshape(23, 3)
    assert pose[JOINT["left_knee"] - 1, 0] > 1.5 and pose[JOINT["right_knee"] - 1, 0] > 1.5
    assert pose[JOINT["left_hip"] - 1, 0] < -1.5 and pose[JOINT["right_hip"] - 1, 0] < -1.5
    assert pose[JOINT["left_elbow"] - 1, 1] < 0 < pose[JOINT["right_elbow"] - 1, 1]


@pytest.fixture(scope="module")
def rebuilt():
    return build_database(DatabaseConfig(variants=2))


def test_the_committed_database_is_what_the_descriptions_give(rebuilt):
    committed = load_database(DEFAULT_DATABASE)
    rows = {name: row for row, name in enumerate(committed.pose_ids.tolist())}
    for row, name in enumerate(rebuilt.pose_ids.tolist()):
        there = rows[name]
        assert np.allclose(committed.body_pose[there], rebuilt.body_pose[row], atol=2e-4), name
        assert committed.actions[there] == rebuilt.actions[row]
        assert committed.categories[there] == rebuilt.categories[row]
    assert len(committed) == 8 * len(rebuilt)


def test_poses_are_within_what_joints_can_do():
    poses = load_database(DEFAULT_DATABASE).body_pose.reshape(-1, 23, 3)
    angles = np.linalg.norm(poses, axis=2)
    assert angles.max() < np.pi
    for side, sign in (("left", -1), ("right", 1)):
        knee, elbow = poses[:, JOINT[f"{side}_knee"] - 1], poses[:, JOINT[f"{side}_elbow"] - 1]
        assert knee[:, 0].min() > -0.25 and knee[:, 0].max() < 2.6
        assert (sign * elbow[:, 1]).min() > -0.25 and (sign * elbow[:, 1]).max() < 2.75


def test_both_sides_are_equally_frequent():
    database = load_database(DEFAULT_DATABASE)
    rows = [i for i, name in enumerate(database.pose_ids.tolist()) if name.startswith("stand_by")]
    poses = database.body_pose[rows].reshape(-1, 23, 3)
    # the touching arm is the one farther from its hanging place
    left = Rotation.from_rotvec(poses[:, JOINT["left_elbow"] - 1]).magnitude()
    right = Rotation.from_rotvec(poses[:, JOINT["right_elbow"] - 1]).magnitude()
    assert 0.3 < np.mean(left > right) < 0.7
