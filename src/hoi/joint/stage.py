"""The joint stage: place body and object together [3.4, Eq. 5]."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from hoi.artifacts import BodyFit, Detection, Frame, Joint, ObjectFit, Prior
from hoi.body import BodyModel, part_vertices
from hoi.errors import ConfigError, FrameFailure
from hoi.exemplars import Exemplar, load_library
from hoi.geometry import rotation_6d_to_matrix
from hoi.joint.config import JointConfig
from hoi.joint.inputs import Inputs
from hoi.joint.optimise import DepthCost, Optimum, minimise
from hoi.joint.problem import BodyRegions, Problem, build_problem
from hoi.joint.select import (
    choose,
    occlusion_order_violation,
    order_violation_by_depth,
    rule_text,
)
from hoi.joint.signed_distance import surface_distance
from hoi.joint.terms import Placement


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
        model = BodyModel.load(body_model)
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
    ) -> Joint:
        """Raises FrameFailure when there is no pose to start from or none stays finite."""
        config = self.config
        if body.body_model and body.body_model != self.body_identity:
            raise ConfigError(
                f"the joint stage loaded body model {self.body_identity}, but {frame.frame_id} was "
                f"fitted with {body.body_model}; give both stages the same `body_model`"
            )
        interaction = prior.retrieved if config.action == "retrieved" else prior.default
        if interaction is None:
            raise FrameFailure("no_prior", f"the prior holds no {config.action} interaction")
        inputs = Inputs.gather(
            frame, detection, body, objects, prior, config.roi_margin, config.camera
        )
        library = self._library(inputs.category)
        problem = build_problem(config, inputs, interaction, library, self.regions, seed)
        order = self._order_cost(inputs, problem) if config.depth_order_weight > 0 else None
        optimum = minimise(problem, config.terms, config.chosen_schedule, order)
        return self._result(frame.frame_id, interaction.action, inputs, problem, optimum)

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

    def _result(
        self, frame_id: str, action: str, inputs: Inputs, problem: Problem, optimum: Optimum
    ) -> Joint:
        """Choose a hypothesis and write it down."""
        config, exemplars = self.config, problem.object.exemplars
        with torch.no_grad():
            placement = Placement(problem, optimum.variables)
            seen = placement.silhouette[1].double()
            vertices = placement.vertices.numpy()
            human_scale = placement.human_scale.double().numpy()
        objects = [v[: len(e.vertices)] for v, e in zip(vertices, exemplars, strict=True)]
        bodies = [scale * inputs.body_vertices for scale in human_scale]
        # nothing behind the camera can explain a picture
        before = torch.tensor([bool(v[:, 2].min() > 0) for v in objects])
        total = torch.where(before, optimum.total, torch.inf).double().numpy()
        violation = occlusion_order_violation(
            objects, [e.faces for e in exemplars], bodies, self.regions.faces, inputs,
            config.order_resolution, config.order_tolerance,
        )  # fmt: skip
        try:
            k = choose(total, violation, config.order_weight)
        except ValueError as error:
            raise FrameFailure("joint_diverged", str(error)) from error
        rotation, translation, scale = _similarity(optimum.variables[k])
        faces, names = exemplars[k].faces, list(config.terms)
        terms = {name: _listed(optimum.terms[i]) for i, name in enumerate(names)}
        terms |= {"total": _listed(total), "order_violation": _listed(violation)}
        terms |= {"iou": _listed(seen), "object_scale_factor": _listed(placement.scale)}
        return Joint(
            frame_id=frame_id,
            detail="; ".join(problem.skipped),
            method=config.method,
            exemplar=exemplars[k].name,
            action=action,
            object_rotation=rotation,
            object_translation=translation,
            object_scale=scale,
            human_scale=float(human_scale[k]),
            object_vertices=objects[k],
            object_faces=faces,
            body_vertices=bodies[k],
            body_joints=human_scale[k] * inputs.body_joints,
            body_model=self.body_identity,
            contact_vertices=touching(bodies[k], objects[k], faces, config.touch_distance),
            hypothesis_exemplars=[e.name for e in exemplars],
            hypothesis_terms=terms,
            selected=k,
            selection_rule=rule_text(config.order_weight),
            loss_curve={name: _listed(optimum.curves[:, i, k]) for i, name in enumerate(names)},
        )


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
