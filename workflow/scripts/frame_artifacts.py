"""What the drawing scripts share: all artifacts of one frame, found through a job's inputs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np

from hoi.actions.database import load_database
from hoi.artifacts import (
    Action,
    Artifact,
    BodyFit,
    Detection,
    Evaluation,
    Frame,
    GroundTruth,
    Joint,
    ObjectFit,
    Prior,
)
from hoi.body.files import BodyFile, read_body_file
from hoi.chunks import Index, artifact_path
from hoi.exemplars import Exemplar, load_library
from hoi.report.page import MethodView
from hoi.report.poses import PoseShelf

A = TypeVar("A", bound=Artifact)


class FrameArtifacts:
    """Reads what every stage said of a frame.

    Args:
        inputs: a job's named inputs: indexes, one or several a stage, and ``settings``, which
            say data set, category, object_name and action of frames that could not be read.
        methods: names whose ``<method>_objects``, ``_joints`` and ``_evaluations`` to read.
    """

    def __init__(self, inputs: Mapping, methods: Sequence[str]):
        self.inputs = inputs
        self.methods = methods
        told = [json.loads(Path(path).read_text()) for path in self._paths("settings")]
        self.settings: dict = told[0]["settings"]
        self.labels: dict[str, dict[str, str]] = {
            k: v for t in told for k, v in t["frames"].items()
        }
        self._libraries: dict[str, list[Exemplar]] = {}
        self._places: dict[str, dict[str, str]] = {}  # input -> frame -> its chunk's index

    @cached_property
    def body_file(self) -> BodyFile:
        """The body model as it is written, read without the libraries that fit it."""
        return read_body_file(self._paths("body_model")[0])

    @property
    def faces(self) -> np.ndarray:
        """(F, 3) of the body model."""
        return self.body_file.faces

    @property
    def poses(self) -> PoseShelf:
        """The poses among which the people's were looked up."""
        return PoseShelf(load_database(self._paths("pose_database")[0]), self.body_file)

    def frame_ids(self) -> Iterator[str]:
        for path in self._paths("frames"):
            yield from Index.load(path).frames

    def frame(self, frame_id: str) -> Frame:
        frame = self._read(Frame, "frames", frame_id)
        assert frame is not None
        return frame if frame.ok else frame.model_copy(update=dict(self.labels[frame_id]))

    def detection(self, frame_id: str) -> Detection | None:
        return self._read(Detection, "detections", frame_id)

    def truth(self, frame_id: str) -> GroundTruth | None:
        truth = self._read(GroundTruth, "truth", frame_id)
        return truth if truth is not None and truth.ok else None

    def views(self, frame_id: str) -> list[MethodView]:
        """What each method did with the frame."""
        return [
            MethodView(
                name=method,
                body=self._read(BodyFit, "bodies", frame_id),
                objects=self._read(ObjectFit, f"{method}_objects", frame_id),
                action=self._read(Action, "actions", frame_id),
                prior=self._read(Prior, "priors", frame_id),
                joint=self._read(Joint, f"{method}_joints", frame_id),
                evaluation=self._read(Evaluation, f"{method}_evaluations", frame_id),
            )
            for method in self.methods
        ]

    def seconds(self, frame_id: str) -> dict[str, float]:
        """What each stage took for a frame, by the stage's folder, in order."""
        found = {}
        for path in self._paths("seconds"):
            taken = json.loads(Path(path).read_text())
            if frame_id in taken:
                stage = "/".join(Path(path).parts[2:-1])  # results/<data set>/<stage>/<chunk>
                found[stage] = taken[frame_id]
        return found

    def exemplars(self, category: str) -> list[Exemplar]:
        """The exemplars of a category; none for a category without a library."""
        if category not in self._libraries:
            found = [path for path in self._paths("exemplars") if Path(path).stem == category]
            self._libraries[category] = (
                load_library(Path(found[0]).parent, category) if found else []
            )
        return self._libraries[category]

    def _read(self, kind: type[A], name: str, frame_id: str) -> A | None:
        if name not in self._places:
            self._places[name] = {
                listed: index for index in self._paths(name) for listed in Index.load(index).frames
            }
        index = self._places[name].get(frame_id)
        return None if index is None else kind.load(artifact_path(index, frame_id))

    def _paths(self, name: str) -> list[str]:
        paths = self.inputs.get(name, [])
        return [paths] if isinstance(paths, str) else list(paths)
