"""The paper's filters: which images show one person who does something with one object."""

from __future__ import annotations

from hoi.artifacts import Candidate, Detection
from hoi.detect.boxes import longer_side, overlap
from hoi.detect.choice import CHOSEN
from hoi.detect.labels import PERSON
from hoi.errors import FrameFailure
from hoi.interactions.config import InteractionsConfig

# verdicts of boxes that are people, or things of the class, though not the ones that were chosen
_OTHER_PEOPLE = ("other_person", "background_person")
_OTHER_OBJECTS = ("other_object", "too_far_from_person")


def check_interaction(detection: Detection, config: InteractionsConfig) -> None:
    """Pass an image of exactly one person and one object whose boxes overlap.

    Raises FrameFailure: several_people, several_objects, or no_interaction. What the user drew or
    gave as a mask is not counted again: an image without other boxes has one of each.
    """
    people = _others(detection, config.person_score, _OTHER_PEOPLE, {PERSON})
    if people:
        raise FrameFailure("several_people", f"{len(people) + 1} people; {_told(people)}")
    chosen = {c.label for c in detection.candidates if c.verdict == CHOSEN} - {PERSON}
    objects = _others(detection, config.object_score, _OTHER_OBJECTS, chosen)
    if objects:
        raise FrameFailure("several_objects", f"{len(objects) + 1} objects; {_told(objects)}")
    assert detection.person_box is not None and detection.object_box is not None
    person, thing = (tuple(map(float, box)) for box in (detection.person_box, detection.object_box))
    iou = overlap(person, thing)  # type: ignore[arg-type]  # four numbers each
    if iou < config.min_box_iou:
        raise FrameFailure(
            "no_interaction",
            f"the boxes of person and object have an IoU of {iou:.3f}; "
            f"{config.min_box_iou:g} are needed",
        )


def check_fit(
    reprojection_error_px: float | None, detection: Detection, config: InteractionsConfig
) -> None:
    """Pass a body that explains its keypoints; raises FrameFailure ``poor_body_fit``."""
    if reprojection_error_px is None or detection.person_box is None:
        return
    side = longer_side(tuple(map(float, detection.person_box)))  # type: ignore[arg-type]
    share = reprojection_error_px / max(side, 1e-9)
    if share > config.max_keypoint_error:
        raise FrameFailure(
            "poor_body_fit",
            f"the body misses its keypoints by {100 * share:.1f} % of the person's length; "
            f"{100 * config.max_keypoint_error:g} % are allowed",
        )


def _others(
    detection: Detection, score: float, verdicts: tuple[str, ...], labels: set[str]
) -> list[Candidate]:
    return [
        candidate
        for candidate in detection.candidates
        if candidate.verdict in verdicts and candidate.label in labels and candidate.score >= score
    ]


def _told(candidates: list[Candidate]) -> str:
    best = max(candidates, key=lambda candidate: candidate.score)
    return f"another {best.label} scores {best.score:.2f}"
