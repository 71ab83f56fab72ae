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
from hoi.geometry import axis_angle_to_matrix, matrix_to_axis_angle
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

GIVEN = "given:"
SMPL_VERTICES = 6890


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
        if config.given == "result" and frame.given_poses is not None:
            return self._given_result(frame.frame_id, names, starts, energy)
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
        names, starts = self._with_given(frame, names, starts)
        points = self._kinematics(starts.root, starts.body_pose, starts.betas).keypoints
        transl = solve_translation(points, keypoints, confidence, intrinsics)
        starts = starts._replace(transl=transl)
        sure = names[0] == "landmarks" or names[0].startswith(GIVEN)
        depth = transl[:1, 2] if sure else transl[:, 2].median()
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

    def _with_given(
        self, frame: Frame, names: list[str], starts: Bodies
    ) -> tuple[list[str], Bodies]:
        """The starts, with the bodies that another system gives in front or alone."""
        if frame.given_poses is None or not len(frame.given_poses):
            return names, starts
        poses = torch.as_tensor(frame.given_poses)
        given = Bodies(
            axis_angle_to_matrix(poses[:, 0]),
            poses[:, 1:].reshape(len(poses), 69),
            self._given_betas(frame),
            torch.zeros(len(poses), 3, dtype=torch.float64),
        )
        source = frame.given_by.get("bodies", "file")
        given_names = [f"{GIVEN}{source}-{number}" for number in range(len(poses))]
        if self._config.given != "start":
            return given_names, given
        both = Bodies(*(torch.cat(pair) for pair in zip(given, starts, strict=True)))
        return given_names + names, both

    def _given_betas(self, frame: Frame) -> Tensor:
        """(P, K) shapes of the file where the model is SMPL's, whose shape space they are of."""
        assert frame.given_poses is not None
        betas = torch.zeros(len(frame.given_poses), self._model.num_betas, dtype=torch.float64)
        if frame.given_betas is not None and self._model.num_vertices == SMPL_VERTICES:
            count = min(betas.shape[1], frame.given_betas.shape[1])
            betas[:, :count] = torch.as_tensor(frame.given_betas[:, :count])
        return betas

    def _given_result(
        self, frame_id: str, names: list[str], bodies: Bodies, energy: Energy
    ) -> BodyFit:
        """The given body that explains the keypoints best once it stands where they are.

        It may also turn as a whole: it was seen from a crop, whose camera looks elsewhere.
        """
        config = self._config
        steps = config.camera_iterations + config.coarse_iterations
        moved, _ = minimise(energy, bodies, steps, config.initial_damping, camera_only=True)
        best = int(energy.reprojection_error_px(moved).argmin())
        return self._artifact(frame_id, energy, f"{names[best]}, kept", moved.select([best]))

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
    """The `count` bodies of lowest energy; a landmark start always stays in place of the last of
    them, the best given body beside them."""
    order = torch.sort(value, stable=True).indices.tolist()
    kept = order[:count]
    if "landmarks" in names and names.index("landmarks") not in kept:
        kept[-1] = names.index("landmarks")
    given = next((i for i in order if names[i].startswith(GIVEN)), None)
    if given is not None and given not in kept:
        kept.append(given)
    return [names[index] for index in kept], bodies.select(kept)
