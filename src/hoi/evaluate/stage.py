"""Measure one reconstruction against the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hoi.artifacts import Evaluation, Frame, GroundTruth, Joint, Measure
from hoi.body import BodyModel
from hoi.errors import FrameFailure
from hoi.evaluate.alignment import Scene, Similarity, align
from hoi.evaluate.config import EvaluateConfig
from hoi.evaluate.contact import contact_scores
from hoi.geometry.alignment import chamfer_distance, sample_surface


class EvaluateStage:
    """Align, carry the object along, and take the Chamfer distance of each in centimetres."""

    def __init__(self, config: EvaluateConfig, body_model: Path):
        self.config = config
        self.body_faces = BodyModel.load(body_model).faces

    def __call__(self, frame: Frame, truth: GroundTruth, joint: Joint, seed: int) -> Evaluation:
        self._refuse_hidden(truth)
        scene = Scene(truth, joint, self.body_faces)
        main = self._measure(self.config.align, scene, seed)
        return Evaluation(
            frame_id=frame.frame_id,
            dataset=frame.dataset,
            category=frame.category,
            object_name=frame.object_name,
            true_action=frame.action,
            used_action=joint.action,
            method=joint.method,
            protocol=main.protocol,
            human_cm=main.human_cm,
            object_cm=main.object_cm,
            others=self._others(scene, seed),
            contacts=contact_scores(
                scene, self.config.contact_cm, self.config.samples, _body_or_none(scene), seed + 4
            ),
        )

    def _refuse_hidden(self, truth: GroundTruth) -> None:
        wanted, visible = self.config.min_visible_fraction, truth.visible_fraction
        if not wanted:
            return
        if visible is None:
            raise FrameFailure(
                "visibility_unknown",
                "the protocol asks for a visible object, and the mask of the whole object "
                "(obj_rend_full) is not there",
            )
        if visible < wanted:
            raise FrameFailure(
                "object_hidden",
                f"{visible:.0%} of the object is visible, the protocol asks for {wanted:.0%}",
            )

    def _others(self, scene: Scene, seed: int) -> list[Measure]:
        """The further protocols; one that needs what the frame lacks is left out."""
        measured = []
        for name in dict.fromkeys(self.config.also):
            if name == self.config.align:
                continue
            try:
                measured.append(self._measure(name, scene, seed))
            except FrameFailure:
                continue
        return measured

    def _measure(self, name: str, scene: Scene, seed: int) -> Measure:
        truth, joint = scene.truth, scene.joint
        aligned = align(name, scene, seed + 6)
        return Measure(
            name=name,
            protocol=protocol_name(self.config, aligned),
            human_cm=self._chamfer_cm(
                (aligned(_given(joint.body_vertices)), self.body_faces),
                (truth.body_vertices, truth.body_faces),
                seed,
            ),
            object_cm=self._chamfer_cm(
                (aligned(_given(joint.object_vertices)), joint.object_faces),
                (truth.object_vertices, truth.object_faces),
                seed + 2,
            ),
        )

    def _chamfer_cm(self, first, second, seed: int) -> float:
        (vertices, faces), (true_vertices, true_faces) = first, second
        count = self.config.samples
        points = sample_surface(vertices, faces, count, np.random.default_rng(seed))
        true = sample_surface(true_vertices, true_faces, count, np.random.default_rng(seed + 1))
        return 100 * chamfer_distance(points, true)


def _given(vertices: np.ndarray | None) -> np.ndarray:
    assert vertices is not None  # an artifact whose status is ok has them
    return vertices


def _body_or_none(scene: Scene) -> Similarity | None:
    try:
        return align("body", scene, 0)
    except FrameFailure:
        return None


def protocol_name(config: EvaluateConfig, aligned: Similarity) -> str:
    """One readable line that says how the numbers were made."""
    visible = config.min_visible_fraction
    return f"{aligned.how}; Chamfer = sum of both means, {config.samples} samples" + (
        f"; visible >= {visible:g}" if visible else ""
    )
