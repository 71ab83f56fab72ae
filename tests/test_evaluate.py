"""Evaluation: the protocol against closed forms, the tables against hand arithmetic."""

import numpy as np
import pandas as pd
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from hoi.artifacts import ContactScore, Evaluation, Frame, GroundTruth, Joint, Measure
from hoi.body import DEFAULT_BODY, BodyModel
from hoi.errors import FrameFailure
from hoi.evaluate.alignment import Scene, align
from hoi.evaluate.config import EvaluateConfig
from hoi.evaluate.stage import EvaluateStage
from hoi.evaluate.tables import (
    COLUMNS,
    CONTACT_COLUMNS,
    evaluation_frame,
    named_protocols,
    summarise,
    summarise_contacts,
    under_protocol,
)
from hoi.report.tables import paper_reference

BOX = trimesh.creation.box((0.4, 0.9, 0.4))
DENSE = BOX.subdivide().subdivide().subdivide().subdivide()  # as many vertices as a scan
OTHER = BOX.subdivide().subdivide().subdivide()  # the same surface as another mesh


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


def other_topology(body):
    """As many vertices, other faces: another model, whatever its vertex count says."""
    return {"body_model": "another", "body_faces": body.faces[:, [1, 2, 0]]}


def test_vertices_correspond_by_topology_never_by_their_number(scene, body):
    assert "body vertices" in measure(scene).protocol
    other = measure(scene, truth_changes=other_topology(body))
    assert "24 joints" in other.protocol and other.human_cm < 1.6
    # another shape of the same model (a gender, a template) still corresponds
    assert "body vertices" in measure(scene, truth_changes={"body_model": "male"}).protocol
    with pytest.raises(FrameFailure, match="no_correspondence"):
        measure(scene, truth_changes=other_topology(body) | {"body_joints": None})


# ------------------------------------------------------------------------------ further protocols


def further(result) -> dict:
    return {m.name: m for m in result.others}


def placed(mesh, depth: float) -> dict:
    vertices = np.asarray(mesh.vertices + [0, 0, depth], np.float32)
    return {"object_vertices": vertices, "object_faces": np.asarray(mesh.faces)}


def test_stacked_alignment_is_the_least_squares_similarity_of_all_vertices(scene):
    """Against another closed form: a depth error is shared between body and object."""
    _, truth, joint = scene
    true, found = placed(DENSE, 2.5), placed(DENSE, 3.1)
    result = measure(scene, found, true)
    joined = further(result)["joint"]
    assert joined.protocol.startswith("Procrustes on body and object vertices; Chamfer")
    source = np.concatenate([joint.body_vertices, found["object_vertices"]]).astype(float)
    target = np.concatenate([truth.body_vertices, true["object_vertices"]]).astype(float)
    x, y = source - source.mean(0), target - target.mean(0)
    turned = Rotation.align_vectors(y, x)[0].apply(x)
    scale = (turned * y).sum() / (x**2).sum()
    aligned = align(
        "joint",
        Scene(truth.model_copy(update=true), joint.model_copy(update=found), truth.body_faces),
        seed=0,
    )
    np.testing.assert_allclose(aligned(source) - target.mean(0), scale * turned, atol=1e-9)
    # what the body gains by a body-only alignment, the object loses
    assert joined.human_cm > result.human_cm + 1
    assert joined.object_cm < result.object_cm - 5


def test_objects_of_another_mesh_are_not_stacked_and_the_protocol_says_so(scene):
    result = measure(scene, placed(OTHER, 3.1), placed(DENSE, 2.5))
    joined = further(result)["joint"]
    assert "do not correspond" in joined.protocol and "body vertices" in joined.protocol
    assert (joined.human_cm, joined.object_cm) == (result.human_cm, result.object_cm)
    # closest points share the error although no vertex corresponds
    surfaces = further(result)["surfaces"]
    assert "closest object points" in surfaces.protocol
    assert surfaces.object_cm < result.object_cm - 5 and surfaces.human_cm > result.human_cm + 1


def test_closest_points_find_a_similarity_of_the_whole_scene(scene):
    changes = placed(OTHER, 2.5)
    changes["object_vertices"] = moved(changes["object_vertices"])
    changes["body_vertices"] = moved(scene[2].body_vertices)
    result = measure(scene, changes, placed(DENSE, 2.5))
    assert further(result)["surfaces"].object_cm == pytest.approx(result.object_cm, abs=0.3)
    assert further(result)["none"].object_cm > 50
    assert further(result)["none"].protocol.startswith("no alignment;")


def test_protocols_that_a_frame_cannot_meet_are_left_out(scene, body):
    """Without any correspondence only the unaligned numbers exist."""
    lost = other_topology(body) | {"body_joints": None}
    result = measure(scene, truth_changes=lost, align="none")
    assert result.others == [] and result.contacts == []
    assert result.protocol.startswith("no alignment;")


# --------------------------------------------------------------------------------------- contact


def touching(body, limit_cm):
    """The truth by brute force: distance of every body vertex to the box, in closed form."""
    person = np.asarray(body.v_template, dtype=np.float64) + [0, 0, 3]
    low, high = BOX.bounds + [0, 0, 2.86]
    outside = np.maximum(np.maximum(low - person, person - high), 0)
    distance = np.linalg.norm(outside, axis=1)
    inside = np.minimum(person - low, high - person).min(1)
    distance = np.where(inside > 0, inside, distance)
    return distance < limit_cm / 100


def test_contact_precision_and_recall_count_touching_vertices(scene, body):
    near = {"object_vertices": (BOX.vertices + [0, 0, 2.86]).astype(np.float32)}
    result = measure(scene, near, near, samples=40_000, also=())
    for score in result.contacts:
        assert score.precision > 0.97 and score.recall > 0.97
        assert score.correspondence == "body vertices"
    assert [score.threshold_cm for score in result.contacts] == [2.0, 5.0]
    # the object a little to the side: shares against the closed form
    shifted = {"object_vertices": (BOX.vertices + [0.1, 0, 2.86]).astype(np.float32)}
    result = measure(scene, shifted, near, samples=40_000, also=())
    person = np.asarray(body.v_template, dtype=np.float64)
    other = BodyShifted(body, person - [0.1, 0, 0])
    for score in result.contacts:
        true, found = touching(body, score.threshold_cm), touching(other, score.threshold_cm)
        assert score.precision == pytest.approx((true & found).sum() / found.sum(), abs=0.03)
        assert score.recall == pytest.approx((true & found).sum() / true.sum(), abs=0.03)


class BodyShifted:
    def __init__(self, body, v_template):
        self.v_template = v_template


def test_contacts_of_another_topology_come_from_the_nearest_true_vertex(scene, body):
    near = {"object_vertices": (BOX.vertices + [0, 0, 2.86]).astype(np.float32)}
    result = measure(scene, near, near | other_topology(body))
    for score in result.contacts:
        assert score.precision > 0.9 and score.recall > 0.9
        assert score.correspondence == "nearest true vertex after alignment"


def test_shares_that_are_not_defined_are_empty(scene):
    far = {"object_vertices": (BOX.vertices + [0, 0, 9.0]).astype(np.float32)}
    near = {"object_vertices": (BOX.vertices + [0, 0, 2.86]).astype(np.float32)}
    lost, invented = measure(scene, far, near).contacts[0], measure(scene, near, far).contacts[0]
    assert (lost.precision, lost.recall) == (None, 0.0)
    assert (invented.precision, invented.recall) == (0.0, None)


# ----------------------------------------------------------------------------------------- tables


def test_hidden_objects_are_left_out_when_the_protocol_says_so(scene):
    with pytest.raises(FrameFailure, match="object_hidden"):
        measure(scene, min_visible_fraction=0.9)
    with pytest.raises(FrameFailure, match="visibility_unknown"):
        measure(scene, None, {"visible_fraction": None}, min_visible_fraction=0.3)
    assert "visible >= 0.3" in measure(scene, min_visible_fraction=0.3).protocol


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


def test_frames_that_the_protocol_leaves_out_are_no_failures():
    frames = evaluations()
    frames.loc[frames["frame_id"] == "d", "status"] = "object_hidden"
    table = summarise(frames, "chair", ["ours"], "given", failure_cm=100)
    assert list(table["n_failed"]) == [0, 0, 0] and list(table["n"]) == [1, 2, 3]


def test_every_protocol_has_its_table_and_its_name():
    values = {"frame_id": "a", "method": "ours", "protocol": "main", "human_cm": 5, "object_cm": 20}
    other = Measure(name="none", protocol="no alignment; x", human_cm=7, object_cm=90)
    scores = [
        ContactScore(threshold_cm=2, precision=0.5, recall=None, correspondence="body vertices"),
        ContactScore(threshold_cm=5, precision=0.25, recall=1.0, correspondence="body vertices"),
    ]
    made = [
        Evaluation(**values, others=[other], contacts=scores),
        Evaluation(**values | {"frame_id": "b"}),
        Evaluation.failed("c", FrameFailure("no_object_detected", "nothing"), "detect"),
    ]
    labels = {
        key: {"dataset": "toy", "category": "chair", "action": "sit", "method": "ours"}
        for key in "abc"
    }
    frames = evaluation_frame(under_protocol(made, "none"), labels, {})
    table = named_protocols(summarise(frames, "chair", ["ours"], "given", 100), "none")
    row = table.iloc[0]
    assert (row.protocol, row.n, row.n_failed) == ("no alignment; x", 1, 2)
    assert (row.human_mean_cm, row.object_mean_cm) == (7, 90)
    assert list(frames["status"]) == ["ok", "no_correspondence", "no_object_detected"]
    empty = evaluation_frame(under_protocol(made, "joint"), labels, {})
    table = named_protocols(summarise(empty, "chair", ["ours"], "given", 100), "joint")
    assert set(table["protocol"]) == {"joint: no result"}

    contacts = summarise_contacts(made, labels, "chair", "given")
    assert list(contacts.columns) == list(CONTACT_COLUMNS)
    assert list(contacts["action"]) == ["sit", "avg", "sit", "avg"]
    two, five = contacts.iloc[0], contacts.iloc[2]
    assert (two.threshold_cm, two.n_precision, two.precision_mean, two.n_recall) == (2, 1, 0.5, 0)
    assert (five.threshold_cm, five.precision_mean, five.recall_mean) == (5, 0.25, 1.0)


def test_the_papers_own_numbers_lie_beside_the_tables_with_their_contradictions():
    printed = paper_reference()
    averages = printed[(printed["action"] == "avg") & (printed["label"] != "tab:ablation")]
    rows = printed[(printed["action"] != "avg") & (printed["label"] != "tab:ablation")]
    means = rows.groupby(["table", "method"])["object_mean_cm"].mean()
    odd = {
        (row.table, row.method)
        for row in averages.itertuples()
        if abs(means[row.table, row.method] - row.object_mean_cm) > 0.2
    }
    assert odd == {("table", "ours"), ("backpack", "phosa")}
    for row in averages.itertuples():
        assert bool(row.note) == ((row.table, row.method) in odd)
