"""What methods are told that give no results: parts of the truth, to see what causes the error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hoi.artifacts import BodyFit, GroundTruth
from hoi.errors import FrameFailure
from hoi.geometry import chamfer_distance, sample_surface, similarity_procrustes
from hoi.joint.inputs import Inputs


def true_body(body: BodyFit, truth: GroundTruth) -> BodyFit:
    """The fit with the true vertices and joints. Raises FrameFailure when the model differs."""
    _same_model(body.body_model, truth)
    return body.model_copy(update={"vertices": truth.body_vertices, "joints": truth.body_joints})


def nearest_to_truth(
    score: np.ndarray,
    points: Sequence[np.ndarray],
    inputs: Inputs,
    body_model: str,
    truth: GroundTruth,
) -> int:
    """Index of the finite hypothesis whose points come nearest to the true object.

    The fitted body is aligned to the true one first, as in the evaluation. Raises FrameFailure when
    their vertices do not correspond.
    """
    assert truth.body_vertices is not None and truth.object_vertices is not None
    assert truth.object_faces is not None
    _same_model(body_model, truth)
    scale, rotation, shift = similarity_procrustes(inputs.body_vertices, truth.body_vertices)
    true = sample_surface(
        truth.object_vertices, truth.object_faces, len(points[0]), np.random.default_rng(0)
    )
    error = [chamfer_distance(scale * own @ rotation.T + shift, true) for own in points]
    return int(np.where(np.isfinite(score), error, np.inf).argmin())


def _same_model(body_model: str, truth: GroundTruth) -> None:
    if truth.body_model != body_model or truth.body_joints is None:
        raise FrameFailure(
            "no_correspondence",
            f"the true body ({truth.body_model or 'unnamed'}) is not the fitted model",
        )
