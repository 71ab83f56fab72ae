"""One self-contained HTML page a frame: input, every stage's decision, and the scene in 3D.

The page fetches nothing: it works from a disk, offline, and inside Snakemake's report, which
shows it as a ``data:`` URL in an iframe.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hoi.artifacts import (
    Action,
    BodyFit,
    Detection,
    Evaluation,
    Frame,
    GroundTruth,
    Joint,
    ObjectFit,
    Prior,
)
from hoi.errors import AssetError
from hoi.report.config import ReportConfig
from hoi.report.html import image_url, render, source
from hoi.report.labels import method_label
from hoi.report.outcomes import (
    Outcome,
    describe_action,
    describe_body,
    describe_detection,
    describe_evaluation,
    describe_joint,
    describe_objects,
    describe_prior,
    number,
    share,
)
from hoi.report.overlay import (
    NOT_RUN,
    Panel,
    body_panel,
    detection_panel,
    exemplar_panels,
    joint_panels,
)
from hoi.report.scene import Reconstruction, of_joint, of_truth, scene_glb
from hoi.report.viewer import packed, three_js

if TYPE_CHECKING:
    from hoi.exemplars.library import Exemplar

TRUTH = "truth"
SHOWN_FIRST = "ours"


@dataclass(frozen=True, eq=False)
class MethodView:
    """What one method (a row of the result table) did with a frame; None: stage not run."""

    name: str
    body: BodyFit | None = None
    objects: ObjectFit | None = None
    action: Action | None = None
    prior: Prior | None = None
    joint: Joint | None = None
    evaluation: Evaluation | None = None

    def problem(self) -> tuple[str, str, str] | None:
        """Status, failed stage and detail of the first artifact that is not ok; None if none."""
        stages = {
            "smplify": self.body,
            "objectfit": self.objects,
            "actions": self.action,
            "priors": self.prior,
            "joint": self.joint,
            "evaluate": self.evaluation,
        }
        for stage, artifact in stages.items():
            if artifact is not None and not artifact.ok:
                return artifact.status, artifact.failed_stage or stage, artifact.detail
        return None


def frame_page(
    frame: Frame,
    detection: Detection | None,
    methods: Sequence[MethodView],
    body_faces: np.ndarray,
    exemplars: Mapping[str, Exemplar] | Sequence[Exemplar] = (),
    config: ReportConfig | None = None,
    *,
    truth: GroundTruth | None = None,
) -> str:
    """The page of one frame as one HTML string; equal inputs give equal text.

    Args:
        frame, detection: shared by all methods; any status is welcome.
        methods: side by side in this order.
        body_faces: (F, 3) of the body model that the methods used.
        exemplars: of the frame's category, by name or in a row.
        truth: true meshes, shown in 3D beside the methods when given.
    """
    config = config or ReportConfig()
    scenes, viewer_problem = _scenes(frame, methods, truth, body_faces, config)
    detected = _picture(detection_panel(frame, detection, config), config)
    bodies = _shared_panels(
        methods,
        "body",
        lambda method: [body_panel(frame, detection, method.body, body_faces, config)],
        config,
    )
    fits = _shared_panels(
        methods,
        "objects",
        lambda method: exemplar_panels(frame, detection, method.objects, exemplars, config),
        config,
    )
    results = [
        (
            method.name,
            [
                _picture(panel, config)
                for panel in joint_panels(frame, detection, method.joint, body_faces, config)
            ],
        )
        for method in methods
    ]
    _quieten([detected, *(p for _, panels in (*bodies, *fits, *results) for p in panels)])
    return render(
        "frame.html.j2",
        style=source("style.css") + source("frame.css"),
        script=source("viewer.js"),
        library=packed(three_js().encode()) if scenes else "",
        frame=frame,
        file_name=re.sub(r"[^A-Za-z0-9._-]+", "_", frame.frame_id),
        problem=_problem(frame, detection, methods),
        errors=_errors(methods),
        protocol=_protocol(methods),
        detection=detected,
        bodies=bodies,
        fits=fits,
        results=results,
        scenes=scenes,
        first_scene=next((s["name"] for s in scenes if s["name"] == SHOWN_FIRST), ""),
        viewer_problem=viewer_problem,
        outcomes=_outcomes(detection, methods, config),
        config=config,
    )


def _picture(panel: Panel, config: ReportConfig) -> dict[str, str]:
    # A stopped stage is text, not a picture of text, except where there is something to see.
    silent = bool(panel.stopped) and panel.alt.startswith(panel.title + ":")
    return {
        "title": panel.title,
        "alt": panel.alt,
        "caption": panel.caption,
        "stopped": panel.stopped,
        "quiet": "",
        "url": "" if silent else image_url(panel.image, config),
        "width": str(panel.image.shape[1]),
        "height": str(panel.image.shape[0]),
    }


def _quieten(pictures: list[dict[str, str]]) -> None:
    """Mark every reason after its first telling, and stages that did not run, as quiet."""
    told: set[str] = set()
    for picture in pictures:
        reason = picture["stopped"]
        if reason in told or reason.endswith(NOT_RUN):
            picture["quiet"] = "quiet"
        told.add(reason)


def _shared_panels(
    methods: Sequence[MethodView],
    field: str,
    draw: Callable[[MethodView], Sequence[Panel]],
    config: ReportConfig,
) -> list[tuple[str, list[dict[str, str]]]]:
    """Panels of an artifact that several methods may share, drawn once; names joined."""
    groups: dict[bytes, list[MethodView]] = {}
    for method in methods:
        artifact = getattr(method, field)
        key = b"" if artifact is None else artifact.to_bytes()
        groups.setdefault(key, []).append(method)
    return [
        (
            ", ".join(method_label(method.name) for method in group) if len(groups) > 1 else "",
            [_picture(panel, config) for panel in draw(group[0])],
        )
        for group in groups.values()
    ]


def _problem(
    frame: Frame, detection: Detection | None, methods: Sequence[MethodView]
) -> tuple[str, str, str] | None:
    """Status, stage and detail that the page's head shows; None when a method came through."""
    for stage, artifact in (("frame", frame), ("detect", detection)):
        if artifact is not None and not artifact.ok:
            return artifact.status, artifact.failed_stage or stage, artifact.detail
    problems = [method.problem() for method in methods]
    return problems[0] if problems and all(problems) else None


def _errors(methods: Sequence[MethodView]) -> list[dict[str, str]]:
    rows = []
    for method in methods:
        found = method.evaluation
        problem = method.problem()
        rows.append(
            {
                "name": method.name,
                "human": number(None if found is None else found.human_cm, 1),
                "object": number(None if found is None else found.object_cm, 1),
                "action": (found.used_action if found is not None else "")
                or (method.joint.action if method.joint is not None else ""),
                "status": "ok" if problem is None else problem[0],
            }
        )
    return rows


def _protocol(methods: Sequence[MethodView]) -> str:
    named = {m.evaluation.protocol for m in methods if m.evaluation is not None}
    return ", ".join(sorted(named - {""}))


def _scenes(
    frame: Frame,
    methods: Sequence[MethodView],
    truth: GroundTruth | None,
    body_faces: np.ndarray,
    config: ReportConfig,
) -> tuple[list[dict[str, str]], str]:
    """Compressed GLBs by name for the 3D view, and why there is none if so."""
    found: list[tuple[str, Reconstruction]] = [
        (method.name, of_joint(method.joint, body_faces))
        for method in methods
        if method.joint is not None and method.joint.ok
    ]
    if truth is not None and truth.ok:
        found.append((TRUTH, of_truth(truth)))
    if not found:
        return [], "No method came as far as a scene, so there is nothing to show in 3D."
    try:
        three_js()
    except AssetError as error:
        return [], str(error)
    size = None if frame.image is None else (frame.image.shape[1], frame.image.shape[0])
    scenes = []
    for name, reconstruction in found:
        data = scene_glb(
            reconstruction,
            config,
            intrinsics=frame.intrinsics,
            image_size=size,
            description=f"{frame.frame_id} {name}",
            compact=True,
        )
        scenes.append({"name": name, "data": packed(data)})
    return scenes, ""


def _outcomes(
    detection: Detection | None, methods: Sequence[MethodView], config: ReportConfig
) -> list[Outcome]:
    told = [describe_detection(detection, config)]
    per_method = (
        lambda m: describe_body(m.body),
        lambda m: describe_objects(m.objects, config),
        lambda m: describe_action(m.action),
        lambda m: describe_prior(m.prior),
        lambda m: describe_joint(m.joint),
        lambda m: describe_evaluation(m.evaluation),
    )
    for describe in per_method:
        told.extend(share((method.name, describe(method)) for method in methods))
    return told
