"""Which person and which object: the written rule, and a verdict for every box that lost.

1. People scoring under the threshold are out (``below_threshold``); so is a box that lies mostly in
   that of a surer person (``same_person``: a part of the body, or its double), and one that is
   smaller than a share of the largest person's (``background_person``).
2. Boxes whose class does not stand for the category are out (``other_class``); the others' scores
   are weighted (look-alike classes count less) and compared with the threshold.
3. Every remaining pair is rated ``person score x object score x nearness x size``: nearness falls
   linearly from 1 where the boxes touch to 0 at the reach, and is 0 where both boxes are the same
   (``same_as_person``); size is the square root of the person's area over the largest person's.
   The best pair is chosen, the earlier box winning a tie.

What the user said goes first: of people, only the one counted or pointed at is left; of objects,
only boxes around the point, whatever their score and distance, and of any class where none of the
category's lies there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hoi.artifacts import Candidate, Hints
from hoi.detect.backends import Box, DetectedBox
from hoi.detect.boxes import area, gap, longer_side, overlap, shared_area
from hoi.detect.config import DetectConfig
from hoi.detect.labels import ANY_CATEGORY, PERSON
from hoi.errors import FrameFailure

CHOSEN = "chosen"
NO_HINTS = Hints()


@dataclass(frozen=True)
class Choice:
    """The chosen pair (each may be missing) and the verdict on every box, in the order given."""

    person: DetectedBox | None
    object: DetectedBox | None
    verdicts: tuple[str, ...]
    rivals: int  # other people who could as well have been meant

    def candidates(self, boxes: Sequence[DetectedBox]) -> list[Candidate]:
        return [
            Candidate(
                label=item.label,
                score=item.score,
                box=item.box,
                verdict=verdict,
                source=item.source,
            )
            for item, verdict in zip(boxes, self.verdicts, strict=True)
        ]


def choose(
    boxes: Sequence[DetectedBox],
    weights: dict[str, float],
    config: DetectConfig,
    hints: Hints = NO_HINTS,
) -> Choice:
    """Apply the rule of this module.

    Args:
        boxes: everything the detector saw.
        weights: detector label -> factor on its score, for the frame's category.
        config: thresholds and reach.
        hints: what the user said; its boxes count as detected ones and are not looked at here.
    """
    weights = _pointed_weights(boxes, weights, hints)
    verdicts = [_screen(index, boxes, weights, config, hints) for index in range(len(boxes))]
    _keep_the_meant_person(boxes, verdicts, hints)
    open_cases = [index for index, verdict in enumerate(verdicts) if not verdict]
    people = [index for index in open_cases if boxes[index].label == PERSON]
    objects = [index for index in open_cases if boxes[index].label != PERSON]
    largest = max((area(boxes[index].box) for index in people), default=0.0)

    def rating(person: int, thing: int) -> float:
        body, candidate = boxes[person], boxes[thing]
        score = candidate.score * weights[candidate.label]
        size = (area(body.box) / largest) ** 0.5
        pointed = hints.object_point is not None
        near = 1.0 if pointed else _nearness(body.box, candidate.box, config)
        return body.score * score * near * size

    pairs = [(rating(person, thing), -person, -thing) for person in people for thing in objects]
    best = max(pairs, default=(0.0, 0, 0))
    person = thing = None
    if best[0] > 0:
        person, thing = -best[1], -best[2]
    elif people:
        person = max(
            people, key=lambda index: (boxes[index].score * area(boxes[index].box), -index)
        )
    for index in people:
        verdicts[index] = CHOSEN if index == person else "other_person"
    for index in objects:
        verdicts[index] = CHOSEN if index == thing else "other_object"
        if person is not None and rating(person, index) == 0:
            same = _same_thing(boxes[person].box, boxes[index].box, config)
            verdicts[index] = "same_as_person" if same else "too_far_from_person"
    return Choice(
        None if person is None else boxes[person],
        None if thing is None else boxes[thing],
        tuple(verdicts),
        max(len(people) - 1, 0),
    )


def _pointed_weights(
    boxes: Sequence[DetectedBox], weights: dict[str, float], hints: Hints
) -> dict[str, float]:
    """The classes to look at: every one, where the user points at none of the category's."""
    if hints.object_point is None:
        return weights
    there = {b.label for b in boxes if b.label != PERSON and _holds(b.box, hints.object_point)}
    return weights if there & set(weights) else dict.fromkeys(there, 1.0)


def _keep_the_meant_person(boxes: Sequence[DetectedBox], verdicts: list[str], hints: Hints) -> None:
    """Rule out, in `verdicts`, all people but the one whom the user counted or pointed at."""
    people = [i for i, item in enumerate(boxes) if item.label == PERSON and not verdicts[i]]
    people.sort(key=lambda index: boxes[index].box[0] + boxes[index].box[2])
    meant = people
    if hints.person_point is not None:
        around = [i for i in people if _holds(boxes[i].box, hints.person_point)]
        meant = sorted(around, key=lambda index: area(boxes[index].box))[:1]
    elif hints.person is not None:
        meant = people[hints.person - 1 : hints.person]
    for index in set(people) - set(meant):
        verdicts[index] = "not_the_person_asked_for"


def _holds(box: Box, point: Sequence[float]) -> bool:
    return box[0] <= point[0] <= box[2] and box[1] <= point[1] <= box[3]


def _screen(
    index: int,
    boxes: Sequence[DetectedBox],
    weights: dict[str, float],
    config: DetectConfig,
    hints: Hints,
) -> str:
    """Why a box is out of the question whatever it is paired with; empty when it is not."""
    item = boxes[index]
    if item.label != PERSON:
        if hints.object_point is not None:
            if not _holds(item.box, hints.object_point):
                return "not_at_the_point"
            return "" if item.label in weights else "other_class"
        if item.label not in weights:
            return "other_class"
        low = item.score * weights[item.label] < config.object_threshold
        return "below_threshold" if low else ""
    if item.score < config.person_threshold:
        return "below_threshold"
    people = [other for other in boxes if other.label == PERSON and other is not item]
    certain = [other for other in people if other.score >= config.person_threshold]
    if any(
        other.score > item.score and _share(item.box, other.box) >= config.same_person
        for other in certain
    ):
        return "same_person"
    if hints.person_point is not None:
        return ""  # however small
    largest = max((area(other.box) for other in certain), default=0.0)
    return "background_person" if area(item.box) < config.rival_area * largest else ""


def _share(first: Box, second: Box) -> float:
    """Shared area as a share of the smaller box."""
    smaller = min(area(first), area(second))
    return shared_area(first, second) / smaller if smaller > 0 else 1.0


def _same_thing(person: Box, thing: Box, config: DetectConfig) -> bool:
    return overlap(person, thing) >= config.same_thing


def _nearness(person: Box, thing: Box, config: DetectConfig) -> float:
    if _same_thing(person, thing, config):
        return 0.0
    distance = gap(person, thing) / max(longer_side(person), 1e-9)
    return max(1 - distance / config.reach, 0.0)


def person_failure(
    boxes: Sequence[DetectedBox], config: DetectConfig, hints: Hints = NO_HINTS
) -> FrameFailure:
    """Why there is no person: the best one that was seen, if any."""
    found = sum(item.label == PERSON and item.score >= config.person_threshold for item in boxes)
    if found and hints.person_point is not None:
        x, y = hints.person_point
        return FrameFailure(
            "no_person_detected",
            f"none of the {found} detected people is at ({x:.0f}, {y:.0f}); give a person_box",
        )
    if found and hints.person is not None:
        return FrameFailure(
            "no_person_detected",
            f"person {hints.person} from the left was asked for and fewer were found; "
            "give a person_point or a person_box",
        )
    best = max((item.score for item in boxes if item.label == PERSON), default=None)
    seen = "no person at all" if best is None else f"at best one scoring {best:.2f}"
    return FrameFailure(
        "no_person_detected",
        f"the detector sees {seen}; the threshold is {config.person_threshold}",
    )


def object_failure(
    boxes: Sequence[DetectedBox],
    category: str,
    weights: dict[str, float],
    config: DetectConfig,
    hints: Hints = NO_HINTS,
) -> FrameFailure:
    """Why there is no object: no such class, none over the threshold, or none near the person."""
    if hints.object_point is not None:
        x, y = hints.object_point
        return FrameFailure(
            "no_object_detected",
            f"nothing was detected around ({x:.0f}, {y:.0f}); give the object's box instead",
        )
    if not weights:
        return FrameFailure(
            "no_object_detected",
            f"the detector has no class for {category!r}; give a box or a mask of the object, "
            "or name a class under `labels`",
        )
    scores = [
        (item.score * weights[item.label], item.label) for item in boxes if item.label in weights
    ]
    if not scores:
        reason = "the detector sees none"
    else:
        score, label = max(scores)
        low = score < config.object_threshold
        near = "too low" if low else "but lies too far away or on the person"
        reason = f"the best box ({label}) scores {score:.2f}, {near}"
    noun, advice = category, ""
    if category in ANY_CATEGORY:
        noun, advice = "sure object", "; name the object (objects.yaml), and less is enough"
    return FrameFailure(
        "no_object_detected",
        f"no {noun} next to the person: {reason}; "
        f"the threshold is {config.object_threshold}{advice}",
    )
