"""Evaluation: the protocol against closed forms, the tables against hand arithmetic."""

import numpy as np
import pandas as pd
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from hoi.artifacts import Evaluation, Frame, GroundTruth, Joint
from hoi.body import DEFAULT_BODY, BodyModel
from hoi.errors import FrameFailure
from hoi.evaluate.config import EvaluateConfig
from hoi.evaluate.stage import EvaluateStage
from hoi.evaluate.tables import COLUMNS, evaluation_frame, summarise

BOX = trimesh.creation.box((0.4, 0.9, 0.4))


@pytest.fixture(scope="module")
def body():
    return BodyModel.load(DEFAULT_BODY)


@pytest.fixture(scope="module")
def scene(body):
    """A person, a box half a metre in front, and a perfect reconstruction of both."""
    person = np.asarray(body.v_template, dtype=np.float64) + [0, 0, 3]
    joints = np.random.default_rng(0).normal(size=(24, 3))
    thing = BOX.vertices + [0, 0, 2.5]
    frame = Frame(
        frame_id="f", dataset="toy", category="chair", action="sit",
        image=np.zeros((2, 2, 3)), intrinsics=np.eye(3),
    )  # fmt: skip
    truth = GroundTruth(
        frame_id="f", body_model=body.identity, body_vertices=person, body_faces=body.faces,
        body_joints=joints, object_vertices=thing, object_faces=BOX.faces, visible_fraction=0.8,
    )  # fmt: skip
    joint = Joint(
        frame_id="f", method="ours", action="sit", object_vertices=thing, object_faces=BOX.faces,
        body_vertices=person, body_joints=joints, body_model=body.identity, object_scale=1.0,
    )  # fmt: skip
    return frame, truth, joint


def measure(scene, joint_changes=None, truth_changes=None, **config):
    frame, truth, joint = scene
    stage = EvaluateStage(EvaluateConfig(**config), DEFAULT_BODY)
    return stage(
        frame,
        truth.model_copy(update=truth_changes or {}),
        joint.model_copy(update=joint_changes or {}),
        seed=0,
    )


def moved(vertices, scale=1.3):
    rotation = Rotation.from_rotvec([0.2, 0.5, -0.1]).as_matrix()
    return (scale * vertices @ rotation.T + [0.4, -0.2, 1.0]).astype(np.float32)


def test_a_perfect_reconstruction_scores_only_the_sampling_floor(scene):
    result = measure(scene)
    assert 0.8 < result.human_cm < 1.6 and 0.8 < result.object_cm < 2.2


def test_a_similarity_of_the_whole_scene_costs_nothing(scene):
    _, _, joint = scene
    changes = {
        "body_vertices": moved(joint.body_vertices),
        "object_vertices": moved(joint.object_vertices),
    }
    result, perfect = measure(scene, changes), measure(scene)
    assert result.human_cm == pytest.approx(perfect.human_cm, abs=0.05)
    assert result.object_cm == pytest.approx(perfect.object_cm, abs=0.05)
    assert measure(scene, changes, align="none").object_cm > 50


def test_an_object_far_away_costs_twice_its_distance(scene):
    _, _, joint = scene
    far = joint.object_vertices + np.float32([0, 0, 10])
    assert measure(scene, {"object_vertices": far}).object_cm == pytest.approx(2000, rel=0.05)


def test_vertices_correspond_by_model_identity_only(scene):
    assert "body vertices" in measure(scene).protocol
    other = measure(scene, truth_changes={"body_model": "smplh"})
    assert "24 joints" in other.protocol
    with pytest.raises(FrameFailure, match="no_correspondence"):
        measure(scene, truth_changes={"body_model": "smplh", "body_joints": None})


def test_hidden_objects_are_left_out_when_the_protocol_says_so(scene):
    with pytest.raises(FrameFailure, match="object_hidden"):
        measure(scene, min_visible_fraction=0.9)


def evaluations():
    values = {"a": ("sit", 6, 20), "b": ("sit", 8, 30), "c": ("lift", 7, 150), "d": ("lift", 0, 0)}
    made, frames = [], {}
    for frame_id, (action, human, thing) in values.items():
        frames[frame_id] = {
            "dataset": "toy", "category": "chair", "action": action, "method": "ours",
        }  # fmt: skip
        common = {"frame_id": frame_id, "method": "ours", "protocol": "p"}
        if frame_id == "d":
            failure = FrameFailure("no_object_detected", "nothing")
            made.append(Evaluation.failed("d", failure, "detect"))
        else:
            made.append(Evaluation(**common, human_cm=human, object_cm=thing))
    return evaluation_frame(made, frames, dict.fromkeys(frames, 2.0))


def test_the_tidy_table_is_the_papers_arithmetic():
    table = summarise(evaluations(), "chair", ["ours"], "given", failure_cm=100)
    assert list(table.columns) == list(COLUMNS)
    assert list(table["action"]) == ["lift", "sit", "avg"]  # the paper's order, then the average
    lift, sit, avg = (row for _, row in table.iterrows())
    assert (sit.n, sit.n_failed, sit.object_mean_cm, sit.object_std_cm) == (2, 0, 25, 5)
    assert (lift.n, lift.n_failed, lift.object_failure_rate) == (1, 1, 1.0)
    # unweighted over actions, although sit has two frames and lift one
    assert avg.object_mean_cm == pytest.approx((25 + 150) / 2)
    assert avg.object_std_cm == pytest.approx((5 + 0) / 2)
    assert (avg.n, avg.n_failed) == (3, 1)
    assert avg.seconds_per_frame == 2.0


def test_an_action_without_any_result_still_has_its_row():
    frames = evaluations()
    frames = frames[frames["frame_id"] == "d"]
    table = summarise(frames, "chair", ["ours"], "given", failure_cm=100)
    assert list(table["n_failed"]) == [1, 1]
    assert pd.isna(table["object_mean_cm"]).all()
