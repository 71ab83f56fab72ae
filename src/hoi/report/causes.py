"""Why a frame went wrong, in the paper's words: detection, initial object pose, action.

A frame that a stage stopped is told by its stage. A frame that came through with a large error is
told by what was wrong in it: the object's shape and turn, then the action, then its place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hoi.report.config import ReportConfig

if TYPE_CHECKING:
    from hoi.artifacts import Evaluation, GroundTruth, Joint

INPUT, DETECTION, BODY = "input", "detection", "body fit"
OBJECT_POSE, ACTION, PLACEMENT = "initial object pose", "action", "placement"

#: In the order of the pipeline; the sentence that explains each.
CAUSES = {
    INPUT: "The photo or its files could not be used.",
    DETECTION: "Person or object was not found, or not believed.",
    BODY: "No body could be fitted to the keypoints.",
    OBJECT_POSE: "The object is turned or shaped wrongly: no fitted exemplar explains it.",
    ACTION: "Another action was retrieved than the true one.",
    PLACEMENT: "Object and action are right, yet the object stands in the wrong place.",
}

_OF_STAGE = {
    "frame": INPUT, "frames": INPUT, "photos": INPUT, "detect": DETECTION, "smplify": BODY,
    "objectfit": OBJECT_POSE, "actions": ACTION, "priors": ACTION, "joint": PLACEMENT,
    "evaluate": PLACEMENT,
}  # fmt: skip

# The data set names a sequence, ConceptNet an action: which retrieved ones are right for a name.
_RIGHT = {
    "sit": {"sit", "rest"},
    "sitstand": {"sit", "sitstand", "rest"},
    "lift": {"lift", "liftreal", "carry"},
    "liftreal": {"lift", "liftreal", "carry"},
    "typing": {"type", "typing"},
    "back": {"back", "backpack", "carry"},
}
_SAMPLES = 1500


def cause_of_stop(stage: str) -> str:
    """The cause for a frame that `stage` stopped."""
    return _OF_STAGE.get(stage, PLACEMENT)


def action_is_wrong(true_action: str, used_action: str) -> bool:
    """Whether the retrieved action contradicts the sequence's; ``mix`` contradicts nothing."""
    if not true_action or not used_action or true_action == "mix":
        return False
    return used_action not in _RIGHT.get(true_action, {true_action})


def shape_error(joint: Joint, truth: GroundTruth) -> float:
    """How differently two objects are turned and shaped: 0 alike, 0.05 another chair, 0.1 wrong.

    Chamfer distance (sum of both means) of their surfaces after both were brought to one centre
    and one diagonal of their boxes, so that place and size do not count.
    """
    from hoi.geometry import chamfer_distance, sample_surface

    assert joint.object_vertices is not None and joint.object_faces is not None
    assert truth.object_vertices is not None and truth.object_faces is not None

    def plain(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
        points = sample_surface(vertices, faces, _SAMPLES, np.random.default_rng(0))
        low, high = points.min(axis=0), points.max(axis=0)
        return (points - (low + high) / 2) / np.linalg.norm(high - low)

    return chamfer_distance(
        plain(joint.object_vertices, joint.object_faces),
        plain(truth.object_vertices, truth.object_faces),
    )


def cause_of_error(
    joint: Joint, evaluation: Evaluation, truth: GroundTruth | None, config: ReportConfig
) -> str:
    """The cause of a large object error; empty for a frame whose error is not large."""
    if evaluation.object_cm is None or evaluation.object_cm <= config.poor_cm:
        return ""
    known = truth is not None and truth.ok and joint.ok and joint.object_vertices is not None
    if known and truth is not None and shape_error(joint, truth) > config.turned_share:
        return OBJECT_POSE
    if action_is_wrong(evaluation.true_action, evaluation.used_action):
        return ACTION
    return PLACEMENT
