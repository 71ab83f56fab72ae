"""The joint stage: place body and object together [3.4, Eq. 5]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from hoi.artifacts import (
    BodyFit,
    Detection,
    Frame,
    GroundTruth,
    Interaction,
    Joint,
    ObjectFit,
    Prior,
)
from hoi.body import BodyModel, part_vertices
from hoi.errors import ConfigError, FrameFailure
from hoi.exemplars import Exemplar, load_library
from hoi.geometry import rotation_6d_to_matrix
from hoi.joint.arrangement import misplacement
from hoi.joint.config import JointConfig
from hoi.joint.contacts import ContactPair
from hoi.joint.inputs import Inputs
from hoi.joint.limbs import limb_targets, refine_limbs
from hoi.joint.optimise import DepthCost, Optimum, minimise
from hoi.joint.oracle import nearest_to_truth, true_body
from hoi.joint.problem import BodyRegions, Problem, build_problem
from hoi.joint.reading import interactions
from hoi.joint.select import (
    choose,
    occlusion_order_violation,
    order_violation_by_depth,
    rule_text,
    scores,
    surprisal,
)
from hoi.joint.signed_distance import surface_distance
from hoi.joint.terms import Placement
from hoi.joint.ways import Way, ways_of


class JointStage:
    """Optimise the hypotheses of the object fit against body, image and priors; keep the best.

    Args:
        config: the method, see `methods` in `config/config.yaml`.
        body_model: the SMPL-format file the bodies were fitted with.
        exemplars_dir: the library the object fit used.
    """

    def __init__(self, config: JointConfig, body_model: Path, exemplars_dir: Path):
        self.config = config
        self.exemplars_dir = Path(exemplars_dir)
        self.model = model = BodyModel.load(body_model)
        self.body_identity = model.identity
        self.regions = BodyRegions(model.faces, part_vertices(model), model.num_vertices)
        self._libraries: dict[str, list[Exemplar]] = {}

    def __call__(
        self,
        frame: Frame,
        detection: Detection,
        body: BodyFit,
        objects: ObjectFit,
        prior: Prior,
        seed: int,
        truth: GroundTruth | None = None,
    ) -> Joint:
        """Raises FrameFailure when there is no pose to start from or none stays finite.

        `truth` is for methods with an oracle alone.
        """
        config = self.config
        if config.oracle != "none" and truth is None:
            raise ConfigError(f"{config.method}: its oracle {config.oracle!r} needs the truth")
        if config.oracle == "body":
            assert truth is not None
            body = true_body(body, truth)
        if body.body_model and body.body_model != self.body_identity:
            raise ConfigError(
                f"the joint stage loaded body model {self.body_identity}, but {frame.frame_id} was "
                f"fitted with {body.body_model}; give both stages the same `body_model`"
            )
        inputs = Inputs.gather(
            frame, detection, body, objects, prior, config.roi_margin, config.camera
        )
        library = self._library(inputs.category)
        solutions: list[Solution] = []
        field = None
        for way in [
            way
            for interaction in interactions(prior, config.action)
            for way in ways_of(interaction, config.contact_sets)
        ]:
            problem = build_problem(
                config, inputs, way.interaction, library, self.regions, seed, field
            )
            field = problem.body.field
            order = self._order_cost(inputs, problem) if config.depth_order_weight > 0 else None
            optimum = minimise(problem, config.terms, config.chosen_schedule, order)
            solutions.append(self._solution(way, inputs, problem, optimum))
        told = truth if config.oracle == "choice" else None
        joint = self._result(frame.frame_id, inputs, solutions, told)
        if config.limbs == "refined":
            pairs = _locate(solutions, joint.selected or 0)[0].problem.pairs
            assert detection.keypoints is not None
            joint = self._with_refined_limbs(joint, body, detection.keypoints, inputs, pairs, seed)
        return joint

    def _library(self, category: str) -> list[Exemplar]:
        if category not in self._libraries:
            self._libraries[category] = load_library(self.exemplars_dir, category)
        return self._libraries[category]

    def _order_cost(self, inputs: Inputs, problem: Problem) -> DepthCost:
        """Weighted occlusion-order violation (S, K) of the starts at S factors of their scale."""
        config, exemplars = self.config, problem.object.exemplars
        with torch.no_grad():
            vertices = Placement(problem, problem.start).vertices.numpy()
        objects = [v[: len(e.vertices)] for v, e in zip(vertices, exemplars, strict=True)]

        def cost(factors: torch.Tensor) -> torch.Tensor:
            violation = order_violation_by_depth(
                objects, [e.faces for e in exemplars], [inputs.body_vertices] * len(objects),
                self.regions.faces, inputs, config.order_resolution, config.order_tolerance,
                factors.double().numpy(),
            )  # fmt: skip
            return config.depth_order_weight * torch.from_numpy(violation).float()

        return cost

    def _with_refined_limbs(
        self,
        joint: Joint,
        body: BodyFit,
        keypoints: np.ndarray,
        inputs: Inputs,
        pairs: Sequence[ContactPair],
        seed: int,
    ) -> Joint:
        """The result with arms and legs that reach the object where they are said to touch it."""
        config = self.config
        assert joint.object_vertices is not None and joint.object_faces is not None
        (exemplar,) = [e for e in self._library(inputs.category) if e.name == joint.exemplar]
        regions = self.regions.vertices
        targets = limb_targets(
            pairs, exemplar, joint.object_vertices, inputs.body_vertices, regions, seed
        )
        refined = refine_limbs(
            self.model, regions, body, keypoints, inputs.intrinsics, targets,
            config.limb_settings,
        )  # fmt: skip
        if refined is None:
            return joint
        touch = touching(
            refined.vertices, joint.object_vertices, joint.object_faces, config.touch_distance
        )
        gaps = {name: (refined.before[name], refined.after[name]) for name in refined.before}
        return joint.model_copy(
            update={
                "body_pose": refined.body_pose,
                "body_vertices": refined.vertices,
                "body_joints": refined.joints,
                "contact_vertices": touch,
                "limb_gaps": gaps,
            }
        )

    def _solution(self, way: Way, inputs: Inputs, problem: Problem, optimum: Optimum) -> Solution:
        """What selection and artifact need of all hypotheses under one interaction."""
        config, exemplars = self.config, problem.object.exemplars
        with torch.no_grad():
            placement = Placement(problem, optimum.variables)
            vertices = placement.vertices.numpy()
            surface = placement.placed(problem.object.surface_points).numpy()
        objects = [v[: len(e.vertices)] for v, e in zip(vertices, exemplars, strict=True)]
        human_scale = placement.human_scale.double().numpy()
        # nothing behind the camera can explain a picture
        before = torch.tensor([bool(v[:, 2].min() > 0) for v in objects])
        violation = occlusion_order_violation(
            objects, [e.faces for e in exemplars], [s * inputs.body_vertices for s in human_scale],
            self.regions.faces, inputs, config.order_resolution, config.order_tolerance,
        )  # fmt: skip
        return Solution(
            interaction=way.interaction,
            contact_set=way.name,
            problem=problem,
            optimum=optimum,
            objects=objects,
            surface=surface,
            human_scale=human_scale,
            total=torch.where(before, optimum.total, torch.inf).double().numpy(),
            violation=violation,
            misplaced=self._misplaced(way, inputs, placement, objects),
            iou=placement.silhouette[1].double().numpy(),
            scale=placement.scale.double().numpy(),
        )

    def _misplaced(
        self, way: Way, inputs: Inputs, placement: Placement, objects: Sequence[np.ndarray]
    ) -> np.ndarray:
        if not self.config.arrangement_weight:
            return np.zeros(len(objects))
        centres = np.stack([(v.min(0) + v.max(0)) / 2 for v in objects])
        fronts = placement.rotations[:, :, 2].double().numpy()  # of the library's +z
        return misplacement(way.interaction.arrangement, inputs.body_joints, centres, fronts)

    def _untouched(self, solutions: Sequence[Solution]) -> np.ndarray:
        """(K,) what hypotheses pay under whose action nothing touches: no contact can be missed."""
        config = self.config
        weighed = config.untouched_cost if config.terms.get("contact") else 0.0
        return np.concatenate(
            [np.full(len(s.total), 0.0 if s.interaction.contacts else weighed) for s in solutions]
        )

    def _result(
        self,
        frame_id: str,
        inputs: Inputs,
        solutions: Sequence[Solution],
        truth: GroundTruth | None,
    ) -> Joint:
        """Choose a hypothesis and write it down."""
        config = self.config
        total = np.concatenate([solution.total for solution in solutions])
        violation = np.concatenate([solution.violation for solution in solutions])
        surprise = np.concatenate(
            [np.full(len(s.total), surprisal(s.interaction.probability)) for s in solutions]
        )
        try:
            score = scores(total, violation, config.order_weight, surprise, config.action_weight)
        except ValueError as error:
            raise FrameFailure("joint_diverged", str(error)) from error
        misplaced = np.concatenate([solution.misplaced for solution in solutions])
        untouched = self._untouched(solutions)
        score = score + config.arrangement_weight * misplaced + untouched
        points = [points for solution in solutions for points in solution.surface]
        selected = (
            choose(score, points, config.consensus)
            if truth is None
            else nearest_to_truth(score, points, inputs, self.body_identity, truth)
        )
        solution, k = _locate(solutions, selected)
        problem, optimum = solution.problem, solution.optimum
        rotation, translation, scale = _similarity(optimum.variables[k])
        chosen, human_scale = problem.object.exemplars[k], float(solution.human_scale[k])
        body = human_scale * inputs.body_vertices
        names = list(config.terms)
        values = torch.cat([s.optimum.terms for s in solutions], 1)
        terms = {name: _listed(values[i]) for i, name in enumerate(names)}
        terms |= {"total": _listed(total), "order_violation": _listed(violation)}
        if config.arrangement_weight:
            terms["misplacement"] = _listed(misplaced)
        terms["score"] = _listed(score)
        if len(solutions) > 1:
            terms["action_surprisal"] = _listed(surprise)
        terms["iou"] = _listed(np.concatenate([s.iou for s in solutions]))
        terms["object_scale_factor"] = _listed(np.concatenate([s.scale for s in solutions]))
        return Joint(
            frame_id=frame_id,
            detail="; ".join(problem.skipped),
            method=config.method,
            exemplar=chosen.name,
            action=solution.interaction.action,
            object_rotation=rotation,
            object_translation=translation,
            object_scale=scale,
            human_scale=human_scale,
            object_vertices=solution.objects[k],
            object_faces=chosen.faces,
            body_vertices=body,
            body_joints=human_scale * inputs.body_joints,
            body_model=self.body_identity,
            intrinsics=None if config.camera == "photo" else inputs.intrinsics,
            contact_vertices=touching(
                body, solution.objects[k], chosen.faces, config.touch_distance
            ),
            hypothesis_exemplars=[e.name for s in solutions for e in s.problem.object.exemplars],
            hypothesis_actions=[s.interaction.action for s in solutions for _ in s.total],
            hypothesis_contacts=[s.contact_set for s in solutions for _ in s.total]
            if any(s.contact_set for s in solutions)
            else [],
            hypothesis_terms=terms,
            selected=selected,
            selection_rule=rule_text(
                config.order_weight,
                config.action_weight if len(solutions) > 1 else 0.0,
                config.consensus,
                config.arrangement_weight,
                float(untouched.max()),
            ),
            loss_curve={name: _listed(optimum.curves[:, i, k]) for i, name in enumerate(names)},
        )


@dataclass(frozen=True)
class Solution:
    """All hypotheses of one interaction, optimised.

    Attributes:
        objects: K placed meshes (V, 3), camera frame, metres. surface: (K, M, 3) points on them.
        human_scale: (K,).
        total: (K,) final loss, infinite where the object reaches behind the camera.
        violation: (K,) of the occlusion order. misplaced: (K,) by the prior's arrangement.
        iou, scale: (K,) of silhouette and object.
        contact_set: name of the alternative that was tried; empty: the listed contacts.
    """

    interaction: Interaction
    contact_set: str
    problem: Problem
    optimum: Optimum
    objects: list[np.ndarray]
    surface: np.ndarray
    human_scale: np.ndarray
    total: np.ndarray
    violation: np.ndarray
    misplaced: np.ndarray
    iou: np.ndarray
    scale: np.ndarray


def _locate(solutions: Sequence[Solution], index: int) -> tuple[Solution, int]:
    """The solution that the index-th hypothesis of all belongs to, and its place there."""
    for solution in solutions:
        if index < len(solution.total):
            return solution, index
        index -= len(solution.total)
    raise IndexError(index)


def _similarity(variables: torch.Tensor) -> tuple[np.ndarray, np.ndarray, float]:
    """R, t, s with object vertices ``s X R^T + t``: the scale about the camera centre folded in."""
    scale = float(variables[9].double().exp())
    rotation = rotation_6d_to_matrix(variables[:6].double()).numpy()
    return rotation, scale * variables[6:9].double().numpy(), scale


def _listed(values: np.ndarray | torch.Tensor) -> list[float]:
    """JSON has no infinity: a loss that is not finite is written as the largest number."""
    numbers = np.asarray(values, np.float64)
    return np.nan_to_num(numbers, nan=1e30, posinf=1e30, neginf=-1e30).tolist()


def touching(
    body_vertices: np.ndarray, object_vertices: np.ndarray, object_faces: np.ndarray, reach: float
) -> np.ndarray:
    """(V,) per body vertex: 1 at the object's surface, linearly down to 0 at `reach` metres."""
    distance = surface_distance(body_vertices, object_vertices, object_faces)
    return np.clip(1 - distance / reach, 0, 1)
