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
from hoi.report.causes import cause_of_error, cause_of_stop
from hoi.report.config import ReportConfig
from hoi.report.doubts import doubts
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
from hoi.report.poses import PoseShelf, pose_panels
from hoi.report.scene import CAMERA_UP, Reconstruction, gravity_up, of_joint, of_truth
from hoi.report.viewer import packed, three_js
from hoi.report.webscene import web_scene

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
    poses: PoseShelf | None = None,
    seconds: Mapping[str, float] | None = None,
    settings: Mapping[str, object] | None = None,
    index: str = "",
) -> str:
    """The page of one frame as one HTML string; equal inputs give equal text.

    Args:
        frame, detection: shared by all methods; any status is welcome.
        methods: side by side in this order.
        body_faces: (F, 3) of the body model that the methods used.
        exemplars: of the frame's category, by name or in a row.
        truth: true meshes, shown in 3D beside the methods when given.
        poses: what the retrieved poses are drawn from; no pictures of them without.
        seconds: what each stage took.
        settings: the configuration behind the results, as plain data.
        index: where the list of all frames is, relative to the page; empty for none.
    """
    config = config or ReportConfig()
    up = frame_up(methods)
    scenes, data, viewer_problem = _scenes(frame, methods, truth, body_faces, config, up)
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
    retrieved = (
        []
        if poses is None
        else _shared_panels(
            methods,
            "action",
            lambda method: pose_panels(method.body, method.action, poses),
            config,
        )
    )
    results = [
        (
            method.name,
            [
                _picture(panel, config)
                for panel in joint_panels(frame, detection, method.joint, body_faces, config, up)
            ],
            _verdict(method, truth, config),
        )
        for method in methods
    ]
    _quieten([detected, *(p for _, panels in (*bodies, *fits) for p in panels)])
    _quieten([panel for _, panels, _ in results for panel in panels])
    taken = dict(seconds or {})
    return render(
        "frame.html.j2",
        style=source("style.css") + source("frame.css"),
        script=source("viewer.js"),
        library=packed(three_js().encode()) if scenes else "",
        frame=frame,
        file_name=re.sub(r"[^A-Za-z0-9._-]+", "_", frame.frame_id),
        index=index,
        problem=_problem(frame, detection, methods),
        headline=_headline(frame, methods),
        doubts=_doubts(frame, detection, methods),
        protocol=_protocol(methods),
        detection=detected,
        bodies=bodies,
        fits=fits,
        retrieved=[shared for shared in retrieved if shared[1]],
        results=results,
        scenes=scenes,
        scenes_glb=data,
        photo=_texture(frame, config) if scenes else "",
        first_scene=next((name for name in scenes if name == SHOWN_FIRST), ""),
        viewer_problem=viewer_problem,
        outcomes=_outcomes(detection, methods, config),
        seconds=list(taken.items()),
        total_seconds=sum(taken.values()),
        settings=_as_yaml(settings),
        config=config,
    )


def frame_up(methods: Sequence[MethodView]) -> np.ndarray:
    """(3,) against gravity in the camera's frame: what the method shown first says, else others."""
    for method in sorted(methods, key=lambda method: method.name != SHOWN_FIRST):
        up = gravity_up(method.joint, method.prior)
        if up is not CAMERA_UP:
            return up
    return CAMERA_UP


def _texture(frame: Frame, config: ReportConfig) -> str:
    """The photo that the 3D view hangs up where its camera saw it."""
    import cv2

    if frame.image is None:
        return ""
    height, width = frame.image.shape[:2]
    across = min(width, config.image_width)
    size = (across, max(1, round(height * across / width)))
    return image_url(cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA), config)


def _as_yaml(settings: Mapping[str, object] | None) -> str:
    import yaml

    return yaml.safe_dump(settings, sort_keys=False, allow_unicode=True) if settings else ""


def _headline(frame: Frame, methods: Sequence[MethodView]) -> str:
    """One sentence on the method shown first: what the person does, with what, how good."""
    joint = _first(methods)[1]
    if joint is None:
        return ""
    count = 0 if joint.contact_vertices is None else int((joint.contact_vertices > 0).sum())
    touch = f"; {count} vertices of the body touch it" if count else ""
    return f"{joint.action or 'uses'}, {frame.category}{touch}"


def _doubts(frame: Frame, detection: Detection | None, methods: Sequence[MethodView]) -> list[str]:
    fit, joint = _first(methods)
    return [] if joint is None else doubts(frame, detection, fit, joint)


def _first(methods: Sequence[MethodView]) -> tuple[ObjectFit | None, Joint | None]:
    """Of the method shown first, if it came through."""
    shown = next((method for method in methods if method.name == SHOWN_FIRST), None)
    if shown is None or shown.joint is None or not shown.joint.ok:
        return None, None
    return shown.objects, shown.joint


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


def _verdict(method: MethodView, truth: GroundTruth | None, config: ReportConfig) -> dict[str, str]:
    """What stands beside a method's pictures: errors, action, status, the cause of a failure."""
    found, problem = method.evaluation, method.problem()
    cause = cause_of_stop(problem[1]) if problem is not None else ""
    if found is not None and found.ok and method.joint is not None and method.joint.ok:
        cause = cause_of_error(method.joint, found, truth, config)
    return {
        "human": number(None if found is None else found.human_cm, 1),
        "object": number(None if found is None else found.object_cm, 1),
        "action": (found.used_action if found is not None else "")
        or (method.joint.action if method.joint is not None else ""),
        "status": "ok" if problem is None else problem[0],
        "cause": cause,
    }


def _protocol(methods: Sequence[MethodView]) -> str:
    named = {m.evaluation.protocol for m in methods if m.evaluation is not None}
    return ", ".join(sorted(named - {""}))


def _scenes(
    frame: Frame,
    methods: Sequence[MethodView],
    truth: GroundTruth | None,
    body_faces: np.ndarray,
    config: ReportConfig,
    up: np.ndarray,
) -> tuple[list[str], str, str]:
    """Names of the scenes, their compressed GLB, and why there is none if so."""
    found: list[tuple[str, Reconstruction]] = [
        (method.name, of_joint(method.joint, body_faces, up))
        for method in methods
        if method.joint is not None and method.joint.ok
    ]
    # the floor of the method shown first is that of all
    found.sort(key=lambda named: named[0] != SHOWN_FIRST)
    if truth is not None and truth.ok:
        found.append((TRUTH, of_truth(truth, up)))
    if not found:
        return [], "", "No method came as far as a scene, so there is nothing to show in 3D."
    try:
        three_js()
    except AssetError as error:
        return [], "", str(error)
    size = None if frame.image is None else (frame.image.shape[1], frame.image.shape[0])
    data = web_scene(found, config, intrinsics=frame.intrinsics, image_size=size, up=up)
    order = [method.name for method in methods] + [TRUTH]
    return sorted((name for name, _ in found), key=order.index), packed(data), ""


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
