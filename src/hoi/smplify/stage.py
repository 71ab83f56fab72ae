"""The body-fit stage: keypoints of one frame to a posed body in the camera frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from hoi.artifacts import BodyFit, Detection, Frame
from hoi.body.jacobian import KeypointKinematics
from hoi.body.model import BodyModel
from hoi.errors import FrameFailure
from hoi.geometry import matrix_to_axis_angle
from hoi.smplify.config import SmplifyConfig
from hoi.smplify.energy import Bodies, Energy, Observation
from hoi.smplify.prior import PosePrior, most_different, read_pose_database
from hoi.smplify.solver import minimise
from hoi.smplify.starts import (
    database_starts,
    flipped_starts,
    landmark_start,
    scale_landmarks,
    solve_translation,
)


class SmplifyStage:
    """SMPLify (section 3.1, Eqs. 1 and 2) from several starts at once.

    The paper starts from PARE's regression. Here the starts are the detector's 3D landmarks, when
    it has any, and poses of the database facing several ways. All are fitted in one batch with
    the robust scale narrowing and the worse half leaving; then limbs of the best fit are tried
    mirrored in depth. The lowest energy wins; its landmark and upright terms are what prefers one
    of two bodies that look the same.
    """

    def __init__(self, config: SmplifyConfig, body_model: Path, pose_database: Path):
        """Load the body model and the pose database; raises AssetError."""
        self._config = config
        self._model = BodyModel.load(body_model, num_betas=config.num_betas, dtype=torch.float64)
        self._kinematics = KeypointKinematics(self._model)
        database = read_pose_database(pose_database)
        self._prior = PosePrior(database.body_pose, config)
        chosen = most_different(database.body_pose, config.start_poses)
        self._start_names = [database.pose_ids[index] for index in chosen]
        self._start_poses = torch.as_tensor(database.body_pose[chosen])
        zeros = torch.zeros(1, 69, dtype=torch.float64)
        self._rest = self._kinematics(
            torch.eye(3, dtype=torch.float64)[None], zeros, zeros[:, : self._model.num_betas]
        ).keypoints[0]

    @torch.no_grad()
    def __call__(self, frame: Frame, detection: Detection, seed: int = 0) -> BodyFit:
        """Fit the body; the result does not depend on `seed`, for nothing is drawn at random.

        Raises:
            FrameFailure: ``no_keypoints`` when no keypoint has any confidence,
                ``too_few_keypoints`` when fewer than `min_keypoints` count.
        """
        names, starts, energy = self._prepare(frame, detection)
        config = self._config
        starts, value = minimise(
            energy, starts, config.camera_iterations, config.initial_damping, camera_only=True
        )
        names, starts = _keep_best(names, starts, value, config.kept_starts)
        bodies, value = minimise(energy, starts, config.coarse_iterations, config.initial_damping)
        names, bodies = _keep_best(names, bodies, value, config.kept_after_coarse)

        energy = energy.with_robust_scale(config.keypoint_robust_m)
        bodies, value = minimise(energy, bodies, config.fine_iterations, config.initial_damping)
        best = int(value.argmin())
        name, body = names[best], bodies.select([best])
        for _ in range(config.flip_rounds):
            flip, body, improved = self._try_flips(energy, body, value.amin())
            if not flip:
                break
            name, value = f"{name}+flip:{flip}", improved
        return self._artifact(frame.frame_id, energy, name, body)

    def _prepare(self, frame: Frame, detection: Detection) -> tuple[list[str], Bodies, Energy]:
        """Starts with their translation solved, and the energy they will be fitted to."""
        keypoints, confidence = self._usable_keypoints(detection)
        intrinsics = torch.as_tensor(frame.intrinsics, dtype=torch.float64)
        num_betas = self._model.num_betas
        starts = database_starts(self._start_poses, self._config.start_yaws, num_betas)
        names = [
            f"database:{pose}@{360 * yaw // self._config.start_yaws}"
            for pose in self._start_names
            for yaw in range(self._config.start_yaws)
        ]
        landmarks = self._landmarks(detection)
        if landmarks is not None:
            first = landmark_start(landmarks, self._rest, num_betas)
            starts = Bodies(*(torch.cat(pair) for pair in zip(first, starts, strict=True)))
            names = ["landmarks", *names]
        points = self._kinematics(starts.root, starts.body_pose, starts.betas).keypoints
        transl = solve_translation(points, keypoints, confidence, intrinsics)
        starts = starts._replace(transl=transl)
        depth = transl[:1, 2] if landmarks is not None else transl[:, 2].median()
        observation = Observation(
            intrinsics=intrinsics,
            keypoints=keypoints,
            confidence=confidence,
            landmarks=landmarks,
            landmark_confidence=confidence.clamp(min=self._config.landmark_unseen_weight),
            pixels_per_metre=float(intrinsics[0, 0] / depth),
        )
        energy = Energy(
            self._config,
            self._kinematics,
            self._prior,
            observation,
            self._config.keypoint_robust_start_m,
        )
        return names, starts, energy

    def _usable_keypoints(self, detection: Detection) -> tuple[Tensor, Tensor]:
        """Pixels (21, 2) and confidence (21,), zero for what does not count."""
        table = torch.as_tensor(np.asarray(detection.keypoints), dtype=torch.float64)
        if table.shape != (21, 3) or not bool((table[:, 2] > 0).any()):
            raise FrameFailure("no_keypoints", "no keypoint of the person has any confidence")
        confidence = table[:, 2].clamp(0, 1)
        confidence = torch.where(
            confidence >= self._config.min_confidence, confidence, torch.zeros_like(confidence)
        )
        count = int((confidence > 0).sum())
        if count < self._config.min_keypoints:
            raise FrameFailure(
                "too_few_keypoints",
                f"{count} keypoints reach confidence {self._config.min_confidence:g}, "
                f"{self._config.min_keypoints} are needed",
            )
        return table[:, :2], confidence

    def _landmarks(self, detection: Detection) -> Tensor | None:
        if detection.landmarks is None:
            return None
        landmarks = torch.as_tensor(np.asarray(detection.landmarks), dtype=torch.float64)
        if landmarks.shape != (21, 3) or not bool(landmarks.any()):
            return None
        return scale_landmarks(landmarks, self._rest)

    def _try_flips(self, energy: Energy, body: Bodies, value: Tensor) -> tuple[str, Bodies, Tensor]:
        """The best limb flip and its body and energy, or no name when none is better."""
        points = energy.posed(body).keypoints[0] + body.transl[0]
        names, flipped = flipped_starts(body, points, self._rest)
        config = self._config
        flipped, values = minimise(energy, flipped, config.flip_iterations, config.initial_damping)
        best = int(values.argmin())
        chosen, chosen_value = minimise(
            energy, flipped.select([best]), config.fine_iterations, config.initial_damping
        )
        if chosen_value[0] < value - 1e-3:
            return names[best], chosen, chosen_value
        return "", body, value[None]

    def _artifact(self, frame_id: str, energy: Energy, name: str, body: Bodies) -> BodyFit:
        global_orient = matrix_to_axis_angle(body.root)
        vertices, joints = self._model(global_orient, body.body_pose, body.betas, body.transl)
        terms = {key: float(value[0]) for key, value in energy.terms(body).items()}
        return BodyFit(
            frame_id=frame_id,
            body_model=self._model.identity,
            global_orient=global_orient[0].numpy(),
            body_pose=body.body_pose[0].numpy(),
            betas=body.betas[0].numpy(),
            transl=body.transl[0].numpy(),
            vertices=vertices[0].numpy(),
            joints=joints[0].numpy(),
            energy={**terms, "total": sum(terms.values())},
            reprojection_error_px=float(energy.reprojection_error_px(body)[0]),
            initialisation=name,
        )


def _keep_best(
    names: list[str], bodies: Bodies, value: Tensor, count: int
) -> tuple[list[str], Bodies]:
    """The `count` bodies of lowest energy; a landmark start always stays."""
    order = torch.sort(value, stable=True).indices.tolist()
    kept = order[:count]
    if "landmarks" in names and names.index("landmarks") not in kept:
        kept[-1] = names.index("landmarks")
    return [names[index] for index in kept], bodies.select(kept)
