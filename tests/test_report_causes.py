"""Failures in the paper's words: detection, initial object pose, action."""

import numpy as np
import pytest

import report_synthetic as synthetic
from hoi.report.causes import (
    ACTION,
    DETECTION,
    OBJECT_POSE,
    PLACEMENT,
    action_is_wrong,
    cause_of_error,
    cause_of_stop,
    shape_error,
)
from hoi.report.config import ReportConfig

CONFIG = ReportConfig()
TRUTH = synthetic.truth()


def moved(rotation=None, shift=(0.0, 0.0, 0.0), scale=1.0):
    """The true object, turned about its middle, scaled and shifted."""
    points = TRUTH.object_vertices
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    turned = (points - middle) @ (np.eye(3) if rotation is None else rotation).T * scale
    thing = (turned + middle + shift).astype(np.float32)
    return synthetic.joint().model_copy(
        update={"object_vertices": thing, "object_faces": TRUTH.object_faces}
    )


ON_ITS_SIDE = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])


def test_place_and_size_do_not_count_as_shape_but_turning_does():
    placed = shape_error(moved(shift=(3.0, 1.0, 2.0), scale=2.5), TRUTH)
    assert placed < 0.05 < CONFIG.turned_share < shape_error(moved(ON_ITS_SIDE), TRUTH)


def evaluated(cm, true="sit", used="sit"):
    return synthetic.evaluation(object_cm=cm).model_copy(
        update={"true_action": true, "used_action": used}
    )


@pytest.mark.parametrize(
    ("joint", "evaluation", "cause"),
    [
        (moved(), evaluated(8.0, used="lift"), ""),  # good enough, whatever the action
        (moved(ON_ITS_SIDE), evaluated(60.0, used="lift"), OBJECT_POSE),
        (moved(shift=(1, 0, 0)), evaluated(60.0, used="lift"), ACTION),
        (moved(shift=(1, 0, 0)), evaluated(60.0), PLACEMENT),
        (moved(shift=(1, 0, 0)), evaluated(60.0, true="mix", used="lift"), PLACEMENT),
    ],
)
def test_a_large_error_has_one_cause(joint, evaluation, cause):
    assert cause_of_error(joint, evaluation, TRUTH, CONFIG) == cause


def test_without_truth_only_the_action_can_be_told():
    assert cause_of_error(moved(ON_ITS_SIDE), evaluated(60.0), None, CONFIG) == PLACEMENT


def test_a_stopped_frame_is_told_by_its_stage():
    stages = {"detect": DETECTION, "objectfit": OBJECT_POSE, "actions": ACTION, "priors": ACTION}
    assert {stage: cause_of_stop(stage) for stage in stages} == stages


@pytest.mark.parametrize(
    ("true", "used", "wrong"),
    [("sit", "rest", False), ("liftreal", "carry", False), ("sit", "lift", True),
     ("mix", "sit", False), ("", "sit", False), ("hand", "hand", False), ("hand", "sit", True)],
)  # fmt: skip
def test_the_data_sets_names_of_actions_have_several_right_answers(true, used, wrong):
    assert action_is_wrong(true, used) is wrong
