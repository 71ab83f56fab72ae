"""Measure one reconstruction against the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hoi.artifacts import Evaluation, Frame, GroundTruth, Joint
from hoi.body import BodyModel
from hoi.errors import FrameFailure
from hoi.evaluate.config import EvaluateConfig
from hoi.geometry.alignment import chamfer_distance, sample_surface, similarity_procrustes


class EvaluateStage:
    """Procrustes on the body, the same transform on the object, Chamfer of each in centimetres."""

    def __init__(self, config: EvaluateConfig, body_model: Path):
        self.config = config
        self.body_faces = BodyModel.load(body_model).faces

    def __call__(self, frame: Frame, truth: GroundTruth, joint: Joint, seed: int) -> Evaluation:
        visible = truth.visible_fraction
        if visible is not None and visible < self.config.min_visible_fraction:
            raise FrameFailure(
                "object_hidden",
                f"{visible:.0%} of the object is visible, the protocol asks for "
                f"{self.config.min_visible_fraction:.0%}",
            )
        assert joint.body_vertices is not None and joint.object_vertices is not None
        (scale, rotation, translation), how = self._alignment(truth, joint)

        def aligned(vertices: np.ndarray) -> np.ndarray:
            return scale * vertices @ rotation.T + translation

        human = self._chamfer_cm(
            (aligned(joint.body_vertices), self.body_faces),
            (truth.body_vertices, truth.body_faces),
            seed,
        )
        thing = self._chamfer_cm(
            (aligned(joint.object_vertices), joint.object_faces),
            (truth.object_vertices, truth.object_faces),
            seed + 2,
        )
        return Evaluation(
            frame_id=frame.frame_id,
            dataset=frame.dataset,
            category=frame.category,
            object_name=frame.object_name,
            true_action=frame.action,
            used_action=joint.action,
            method=joint.method,
            protocol=protocol_name(self.config, how),
            human_cm=human,
            object_cm=thing,
        )

    def _alignment(self, truth: GroundTruth, joint: Joint):
        """The similarity, and which correspondences gave it.

        Vertices correspond only when both bodies are the same model; equal counts prove nothing.
        """
        if self.config.align == "none":
            return (1.0, np.eye(3), np.zeros(3)), "none"
        assert joint.body_vertices is not None and truth.body_vertices is not None
        if truth.body_model and truth.body_model == joint.body_model:
            return similarity_procrustes(joint.body_vertices, truth.body_vertices), "body vertices"
        if truth.body_joints is None or joint.body_joints is None:
            raise FrameFailure(
                "no_correspondence",
                f"the true body ({truth.body_model or 'unnamed'}) is not the fitted model "
                f"({joint.body_model}) and comes without its 24 joints",
            )
        return similarity_procrustes(joint.body_joints, truth.body_joints), "24 joints"

    def _chamfer_cm(self, first, second, seed: int) -> float:
        (vertices, faces), (true_vertices, true_faces) = first, second
        count = self.config.samples
        points = sample_surface(vertices, faces, count, np.random.default_rng(seed))
        true = sample_surface(true_vertices, true_faces, count, np.random.default_rng(seed + 1))
        return 100 * chamfer_distance(points, true)


def protocol_name(config: EvaluateConfig, correspondences: str) -> str:
    """One readable line that says how the numbers were made."""
    visible = config.min_visible_fraction
    return (
        f"Procrustes on {correspondences}; Chamfer = sum of both means, {config.samples} samples"
        + (f"; visible >= {visible:g}" if visible else "")
    )
