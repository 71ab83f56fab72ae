"""The joint stage as a whole, on a person sitting on a box chair."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from hoi.artifacts import Contact, ContactSet, GroundTruth, Joint
from hoi.body import DEFAULT_BODY
from hoi.errors import ConfigError, FrameFailure
from hoi.exemplars import save_library
from hoi.joint.config import JointConfig
from hoi.joint.reading import what_is_read
from hoi.joint.stage import JointStage, touching
from hoi.joint.ways import ways_of
from joint_scene import (
    METHODS,
    body_model,
    box_chair,
    chair_prior,
    method_config,
    sitting_scene,
)

QUICK = {"optimiser": "adam", "iterations": 15, "learning_rate": 1e-2}


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exemplars")
    save_library([box_chair(), box_chair("other", arms=True)], folder / "chair.npz")
    return folder


def run(scene, library, config, truth=None) -> Joint:
    stage = JointStage(config, DEFAULT_BODY, library)
    return stage(
        scene.frame, scene.detection, scene.body, scene.objects, scene.prior, seed=3, truth=truth
    )


def truth_of(scene) -> GroundTruth:
    return GroundTruth(
        frame_id="toy",
        body_model=scene.body.body_model,
        body_vertices=scene.body.vertices,
        body_faces=body_model().faces,
        body_joints=scene.body.joints,
        object_vertices=scene.true_vertices,
        object_faces=box_chair().faces,
    )


@pytest.mark.parametrize("name", METHODS.methods)
def test_every_method_of_the_tables_gives_a_valid_artifact(name, library, tmp_path):
    scene = sitting_scene(second=True)
    config = method_config(name, fast=QUICK)
    scene.prior = what_is_read(scene.prior, config)  # as in the workflow
    result = run(scene, library, config, truth_of(scene) if config.oracle != "none" else None)
    result.save(tmp_path / "joint.npz")
    again = Joint.load(tmp_path / "joint.npz")
    assert again.to_bytes() == result.to_bytes()
    assert result.method == name
    assert result.action == ("lift" if name.endswith("no_action") else "sit")
    assert result.hypothesis_exemplars == ["box", "other"]
    assert set(result.loss_curve) == set(method_config(name).terms)
    assert {"total", "order_violation", "iou"} <= set(result.hypothesis_terms)


@pytest.mark.parametrize("name", ["ours", "single_action_sets", "no_action", "true_action"])
def test_what_a_method_does_not_read_changes_nothing(name, library):
    config = method_config(name, fast=QUICK)
    scene = with_sets(sitting_scene())
    told = {"hypotheses": [scene.prior.retrieved, scene.prior.default], "true": scene.prior.default}
    whole = scene.prior.model_copy(update=told)
    scene.prior = whole
    told_all = run(scene, library, config)
    scene.prior = what_is_read(whole, config)
    assert scene.prior == what_is_read(scene.prior, config)
    assert run(scene, library, config).to_bytes() == told_all.to_bytes()


def test_a_method_reads_no_words_and_no_other_action():
    prior = chair_prior()
    assert prior.retrieved is not None and prior.default is not None
    words = {"unmapped": ["cushion/pride"], "source": "another model"}
    sets = [ContactSet(name="nothing", contacts=[], probability=0.1)]
    said_otherwise = prior.model_copy(
        update={
            "default": prior.default.model_copy(update={"contacts": []}),
            "hypotheses": [prior.default],
            "true": prior.default,
            "retrieved": prior.retrieved.model_copy(update=words | {"alternatives": sets}),
            "size_source": "another model",
        }
    )
    one = method_config("single_action")
    assert what_is_read(prior, one) == what_is_read(said_otherwise, one)
    for name in ("ours", "no_action", "true_action", "single_action_sets"):
        config = method_config(name)
        assert what_is_read(prior, config) != what_is_read(said_otherwise, config), name


def test_the_artifact_says_how_its_object_was_placed(library):
    scene = sitting_scene()
    result = run(scene, library, method_config("ours"))
    placed = result.object_scale * box_chair().vertices @ result.object_rotation.T
    placed = placed + result.object_translation
    np.testing.assert_allclose(result.object_vertices, placed, atol=1e-4)
    np.testing.assert_allclose(result.body_vertices, scene.body.vertices)
    error = np.linalg.norm(result.object_vertices - scene.true_vertices, axis=1).mean()
    assert error < 0.05
    butt = np.isclose(result.contact_vertices, 1, atol=0.5)
    assert 10 < butt.sum() < len(result.body_vertices) / 4


def test_equal_inputs_give_equal_bytes(library):
    config = method_config("ours")
    first, second = (run(sitting_scene(second=True), library, config) for _ in range(2))
    assert first.to_bytes() == second.to_bytes()


def test_contacts_with_parts_the_exemplars_lack_are_skipped_and_recorded(library):
    scene = sitting_scene()
    result = run(scene, library, method_config("no_action", fast=QUICK))
    assert "chair_arm" in result.detail
    both = run(sitting_scene(second=True), library, method_config("paper", action="default"))
    assert "box has no chair_arm" in both.detail


def test_trouble_with_one_frame_is_a_frame_failure(library):
    scene = sitting_scene()
    scene.objects = scene.objects.model_copy(update={"exemplars": ["gone"]})
    with pytest.raises(FrameFailure, match="unknown_exemplar"):
        run(scene, library, method_config("ours"))
    scene = sitting_scene()
    scene.prior = scene.prior.model_copy(update={"retrieved": None})
    with pytest.raises(FrameFailure, match="no_prior"):
        run(scene, library, method_config("ours"))
    scene = sitting_scene()
    fitted = scene.objects
    scene.objects = fitted.model_copy(update={"exemplars": []})
    with pytest.raises(FrameFailure, match="no_object_pose"):
        run(scene, library, method_config("ours"))
    scene.objects = fitted
    small = scene.detection.person_mask[::2, ::2]
    scene.detection, given = (
        scene.detection.model_copy(update={"person_mask": small}),
        scene.detection,
    )
    with pytest.raises(FrameFailure, match="mask_size_mismatch"):
        run(scene, library, method_config("ours"))
    scene.detection = given
    behind = scene.objects.translations * [1, 1, -1]
    scene.objects = scene.objects.model_copy(update={"translations": behind})
    with pytest.raises(FrameFailure, match="joint_diverged"):
        run(scene, library, method_config("ours", fast=QUICK))


def test_a_body_of_another_model_is_a_configuration_error(library):
    scene = sitting_scene()
    scene.body = scene.body.model_copy(update={"body_model": "another"})
    with pytest.raises(ConfigError, match=body_model().identity):
        run(scene, library, method_config("ours"))


def test_unknown_terms_are_named_in_the_error():
    with pytest.raises(ValidationError, match="gravity"):
        JointConfig(terms={"gravity": 1.0})
    with pytest.raises(ValidationError, match="at least one"):
        JointConfig(terms={})


def test_touch_fades_with_distance():
    chair = box_chair()
    seat = chair.vertices[chair.part_vertices("chair_seat")]
    top = np.array([[0.0, seat[:, 1].max(), 0.0]])
    points = np.concatenate([top, top + [0, 0.025, 0], top + [0, 0.2, 0]])
    found = touching(points, chair.vertices, chair.faces, reach=0.05)
    assert found.tolist() == pytest.approx([1, 0.5, 0], abs=1e-3)


def hypotheses(scene, **probabilities):
    """The scene's prior with its actions as hypotheses of these probabilities."""
    known = {"sit": scene.prior.retrieved, "lift": scene.prior.default}
    tried = [known[name].model_copy(update={"probability": p}) for name, p in probabilities.items()]
    scene.prior = scene.prior.model_copy(update={"retrieved": tried[0], "hypotheses": tried})
    return scene


def test_among_likely_actions_the_picture_decides(library):
    config = method_config("ours", action="hypotheses", action_weight=0.05)
    result = run(hypotheses(sitting_scene(second=True), lift=0.55, sit=0.45), library, config)
    assert result.action == "sit"
    assert result.hypothesis_actions == ["lift", "lift", "sit", "sit"]
    assert result.selected in (2, 3)
    assert result.selection_rule.endswith("- 0.05 x log p(action)")
    assert all(len(values) == 4 for values in result.hypothesis_terms.values())
    alone = run(sitting_scene(second=True), library, method_config("ours"))
    np.testing.assert_array_equal(result.object_vertices, alone.object_vertices)


def test_an_action_without_contacts_does_not_win_by_having_none_to_miss(library):
    scene = hypotheses(sitting_scene(second=True), sit=0.5, lift=0.5)
    beside = scene.prior.hypotheses[1].model_copy(update={"action": "stand by", "contacts": []})
    tried = [scene.prior.hypotheses[0], beside]
    scene.prior = scene.prior.model_copy(update={"hypotheses": tried})

    def chosen(cost):
        changes = {"untouched_cost": cost, "consensus": 0.0, "fast": QUICK}
        return run(scene, library, method_config("ours", action="hypotheses", **changes))

    free, dear = chosen(0.0), chosen(0.1)
    assert free.action == "stand by" and dear.action == "sit"
    assert dear.selection_rule.endswith("+ 0.1 where nothing touches")
    assert "nothing touches" not in free.selection_rule


def test_an_unlikely_action_needs_more_than_a_slightly_better_loss(library):
    config = method_config("ours", action="hypotheses", action_weight=100.0, fast=QUICK)
    result = run(hypotheses(sitting_scene(second=True), lift=0.9, sit=0.1), library, config)
    assert result.action == "lift"


def test_the_oracle_is_told_the_action_where_the_data_set_knows_it(library):
    scene = sitting_scene()
    config = method_config("true_action", fast=QUICK)
    assert run(scene, library, config).action == "sit"
    scene.prior = scene.prior.model_copy(update={"true": scene.prior.default})
    assert run(scene, library, config).action == "lift"


def test_without_hypotheses_the_retrieved_action_is_tried_alone(library):
    config = method_config("ours", action="hypotheses", fast=QUICK)
    result = run(sitting_scene(), library, config)
    assert result.hypothesis_actions == ["sit"]
    assert "action_surprisal" not in result.hypothesis_terms


def test_an_oracle_takes_the_true_body_or_the_best_hypothesis(library):
    scene = sitting_scene(second=True)
    truth = truth_of(scene)
    away = scene.body.model_copy(update={"vertices": scene.body.vertices + [0.3, 0, 0.5]})
    scene.body = away
    told = run(scene, library, method_config("true_body", fast=QUICK), truth)
    np.testing.assert_allclose(told.body_vertices, truth.body_vertices)
    scene = sitting_scene(second=True)
    choice = run(scene, library, method_config("true_choice"), truth)
    assert choice.exemplar == "box"  # the true chair has no arms
    with pytest.raises(ConfigError, match="needs the truth"):
        run(scene, library, method_config("true_choice"))


# ------------------------------------------------------------------- alternative contact sets


def with_sets(scene, **changes):
    """The scene's prior with wrong contacts listed, and the right ones as an alternative."""
    right = scene.prior.retrieved
    wrong = [Contact(object_part="chair_back", body_part="left_foot")]
    sets = [
        ContactSet(name="as listed", contacts=wrong, probability=0.5),
        ContactSet(name="seated", contacts=right.contacts, probability=0.4),
        ContactSet(name="nothing", contacts=[], probability=0.1),
    ]
    listed = right.model_copy(update={"contacts": wrong, "alternatives": sets} | changes)
    scene.prior = scene.prior.model_copy(update={"retrieved": listed})
    return scene


def test_a_right_alternative_wins_over_wrong_listed_contacts(library):
    config = method_config("ours", contact_sets="alternatives", order_weight=0.0)
    result = run(with_sets(sitting_scene(second=True)), library, config)
    assert result.selected is not None
    sets = result.hypothesis_contacts
    assert list(dict.fromkeys(sets)) == ["", "seated", "nothing"]  # equal sets are tried once
    assert len(sets) == len(result.hypothesis_exemplars) == 6
    assert sets[result.selected] in ("seated", "nothing")
    alone = run(with_sets(sitting_scene(second=True)), library, method_config("ours"))
    true = sitting_scene(second=True).true_vertices.mean(0)

    def error(joint):
        return float(np.linalg.norm(joint.object_vertices.mean(0) - true))

    assert error(result) < error(alone)


def test_methods_that_take_the_listed_contacts_do_not_see_the_alternatives(library):
    config = method_config("ours", fast=QUICK)
    without = run(with_sets(sitting_scene(), alternatives=[]), library, config)
    assert run(with_sets(sitting_scene()), library, config).to_bytes() == without.to_bytes()
    tried = method_config("ours", fast=QUICK, contact_sets="alternatives")
    same = run(with_sets(sitting_scene(), alternatives=[]), library, tried)
    assert same.to_bytes() == without.to_bytes() and same.hypothesis_contacts == []


def test_the_probability_of_a_way_is_that_of_action_and_set():
    interaction = with_sets(sitting_scene()).prior.retrieved.model_copy(update={"probability": 0.5})
    ways = ways_of(interaction, "alternatives")
    assert [way.name for way in ways] == ["", "seated", "nothing"]
    assert [way.interaction.probability for way in ways] == [0.5, 0.2, 0.05]
    assert ways[2].interaction.contacts == []
    assert [way.interaction for way in ways_of(interaction, "one")] == [interaction]


def test_a_method_with_a_camera_of_its_own_says_which(library):
    scene = sitting_scene()
    assert run(scene, library, method_config("ours", fast=QUICK)).intrinsics is None
    believed = run(scene, library, method_config("phosa", fast=QUICK)).intrinsics
    assert believed[0, 0] == believed[1, 1] == 640  # the longest side
