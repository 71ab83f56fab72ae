"""The action stage: the action of the single most similar pose [paper 3.2]."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hoi.actions.config import ActionsConfig
from hoi.actions.database import load_database
from hoi.actions.retrieval import Match, PoseIndex, pelvis_up_in_camera, probabilities
from hoi.actions.space import load_action_space
from hoi.artifacts import Action, BodyFit, Frame, Neighbour
from hoi.errors import FrameFailure


class ActionStage:
    """Retrieves what the person does with the frame's object from the estimated body pose.

    Reads the object category of the frame, what the user said of the action, and the pose and tilt
    of the body, nothing else: the data set's own action is the truth that only evaluation may see.

    Args:
        config: settings of the stage.
        pose_database: labelled poses, see :mod:`hoi.actions.database`.
        action_space: ConceptNet edges, see :mod:`hoi.actions.space`.
    """

    def __init__(self, config: ActionsConfig, pose_database: Path | str, action_space: Path | str):
        self._config = config
        self._database = load_database(pose_database)
        self._indexes: dict[str, PoseIndex] = {}
        self._space = load_action_space(action_space, config.min_conceptnet_weight)

    def __call__(self, frame: Frame, body: BodyFit, seed: int = 0) -> Action:
        """The action of the nearest pose among those of the frame's object, or the user's word.

        Raises FrameFailure ``no_pose_for_object`` when the database has none and nobody said.
        """
        if frame.hints.action:
            return self._said(frame, body)
        return self._retrieved(frame, body)

    def _said(self, frame: Frame, body: BodyFit) -> Action:
        """The user's action; what retrieval would have said comes next."""
        said = frame.hints.action
        try:
            found = self._retrieved(frame, body)
        except FrameFailure:
            return Action(
                frame_id=frame.frame_id,
                detail=f"{said}: the user's word",
                action=said,
                distance=0.0,
                default_action=said,
            )
        assert found.action is not None and found.distance is not None
        nearest = Neighbour(pose_id=found.pose_id, action=found.action, distance=found.distance)
        ranked = [nearest, *found.runners_up]
        own = [neighbour.distance for neighbour in ranked if neighbour.action == said]
        return found.model_copy(
            update={
                "detail": f"{said}: the user's word; nearest pose: {found.pose_id} "
                f"({found.action})",
                "action": said,
                "distance": own[0] if own else found.distance,
                "runners_up": [neighbour for neighbour in ranked if neighbour.action != said],
            }
        )

    def _retrieved(self, frame: Frame, body: BodyFit) -> Action:
        assert body.body_pose is not None and body.global_orient is not None
        matches = self._index(frame.category).nearest_per_action(
            body.body_pose, pelvis_up_in_camera(body.global_orient)
        )
        shares = probabilities(
            np.array([match.distance for match in matches.values()]), self._config.temperature
        )
        neighbours = [
            self._neighbour(match, float(share))
            for match, share in zip(matches.values(), shares, strict=True)
        ]
        known = neighbours[0].distance <= self._config.unknown_beyond
        return Action(
            frame_id=frame.frame_id,
            detail=f"nearest pose: {neighbours[0].pose_id}" + ("" if known else ", which is far"),
            action=neighbours[0].action,
            distance=neighbours[0].distance,
            probability=neighbours[0].probability,
            known=known,
            pose_id=neighbours[0].pose_id,
            pose_distance=neighbours[0].distance,
            runners_up=neighbours[1 : 1 + self._config.runners_up],
            default_action=self._default_action(frame.category),
        )

    def _index(self, category: str) -> PoseIndex:
        try:
            if category not in self._indexes:
                self._indexes[category] = PoseIndex(self._database, category, self._config)
            return self._indexes[category]
        except KeyError:
            raise FrameFailure(
                "no_pose_for_object",
                f"the pose database has no pose with a {category!r}; it knows "
                + ", ".join(self._database.all_categories()),
            ) from None

    def _default_action(self, category: str) -> str:
        """The heaviest ConceptNet action that the database knows, else its most frequent one."""
        rows = self._database.rows_of(category)
        labels = self._database.actions[rows].tolist()
        heaviest = self._space.default_action(category, among=labels)
        return heaviest or max(sorted(set(labels)), key=labels.count)

    def _neighbour(self, match: Match, probability: float) -> Neighbour:
        return Neighbour(
            pose_id=str(self._database.pose_ids[match.row]),
            action=str(self._database.actions[match.row]),
            distance=match.distance,
            probability=probability,
        )
