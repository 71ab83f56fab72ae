"""Which person and which object: the written rule, and a verdict with its reason for every box.

1. People scoring under the threshold are out (``below_threshold``); so is a box that lies mostly in
   that of a surer person (``same_person``: a part of the body, or its double), and one that is
   smaller than a share of the largest person's (``background_person``).
2. Looks around each person who is left propose places of the object, with an evidence
   (:mod:`hoi.detect.evidence`). A place is rated ``evidence x contact x size x use``: contact falls
   with the distance from the person's hands, seat, back or feet, whichever touches such things;
   size with how much longer or shorter than such things the box is (:mod:`hoi.detect.touching`);
   use with how little of what the person uses lies in the box, as far as the segmenter's network
   can tell without a box. Without a pose, contact falls linearly with the gap between the boxes.
   Places beyond the reach (``too_far_from_person``) and places whose evidence x size is under the
   threshold (``below_threshold``) are out. The person's own box counts half where such a thing was
   named there, as who sits in an armchair fills its box, and is out (``same_as_person``) otherwise.
3. The pair with the best ``person score x rating x size of the person`` is chosen; that last
   factor is the square root of the person's area over the largest person's.

What the user said goes first: of people, only the one counted or pointed at is left; of places,
only those around the point, however they are rated, and of any class where none of the category's
lies there. A box that the user drew is the person, or the object, without further question.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hoi.artifacts import Candidate, Hints
from hoi.detect.backends import Box, DetectedBox, PersonPose
from hoi.detect.boxes import area, gap, longer_side, overlap, shared_area, weight_inside
from hoi.detect.config import DetectConfig
from hoi.detect.evidence import Proposal
from hoi.detect.labels import ANY_CATEGORY, PERSON
from hoi.detect.touching import (
    distance_m,
    expectation,
    nearness,
    plausible_size,
    touch_points,
)
from hoi.errors import FrameFailure

CHOSEN = "chosen"
NO_HINTS = Hints()
_EVERYWHERE = ("hands", "seat", "back", "feet")


@dataclass(frozen=True)
class Scene:
    """One plausible person and what was seen around them."""

    person: DetectedBox
    pose: PersonPose | None
    proposals: tuple[Proposal, ...]
    #: (H, W) of each pixel to be what this person uses; None when nobody was asked
    in_use: np.ndarray | None = None

    @cached_property
    def _used(self) -> float:
        return 0.0 if self.in_use is None else float(self.in_use.sum())

    def share_in_use(self, box: Box) -> float:
        """How much of what this person uses lies in the box; 0 of nothing."""
        if self.in_use is None or self._used <= 0:
            return 0.0
        return weight_inside(self.in_use, box) / self._used


@dataclass(frozen=True)
class Choice:
    """The chosen pair, each of which may be missing, and what became of every candidate."""

    person: DetectedBox | None
    object: DetectedBox | None
    pose: PersonPose | None
    candidates: tuple[Candidate, ...]
    rivals: int  # other people who could as well have been meant


@dataclass(frozen=True)
class _Rating:
    value: float
    verdict: str  # why the proposal is out, empty when it is not
    reason: str


def chosen_object(candidates: Sequence[Candidate]) -> Candidate | None:
    """The object among the candidates of a detection, if one was chosen."""
    found = (c for c in candidates if c.verdict == CHOSEN and c.label != PERSON)
    return next(found, None)


def choose(
    people: Sequence[DetectedBox],
    verdicts: Sequence[str],
    scenes: Sequence[Scene],
    category: str,
    config: DetectConfig,
    hints: Hints = NO_HINTS,
    unplaced: Sequence[Proposal] = (),
) -> Choice:
    """Apply the rule of this module.

    Args:
        people: every person's box.
        verdicts: what :func:`screen_people` says of them.
        scenes: the people who are left, and the places proposed around each.
        category: the object's noun.
        config: thresholds and weights.
        hints: what the user said.
        unplaced: what was proposed though nobody is there, for the record.
    """
    largest = max((area(scene.person.box) for scene in scenes), default=0.0)
    ratings = [
        [_rate(place, scene, category, config, hints) for place in scene.proposals]
        for scene in scenes
    ]

    def pair(which: int, place: int) -> float:
        body = scenes[which].person
        return body.score * ratings[which][place].value * (area(body.box) / largest) ** 0.5

    pairs = [
        (pair(which, place), -which, -place)
        for which in range(len(scenes))
        for place in range(len(ratings[which]))
        if not ratings[which][place].verdict
    ]
    best = max(pairs, default=None)
    if best is not None:
        chosen, thing = -best[1], -best[2]
    else:
        order = range(len(scenes))
        chosen = max(order, key=lambda i: (_plainness(scenes[i].person), -i), default=None)
        thing = None
    scene = None if chosen is None else scenes[chosen]
    candidates = [
        _person_candidate(box, verdict, scene, len(scenes))
        for box, verdict in zip(people, verdicts, strict=True)
    ]
    if scene is not None and chosen is not None:
        candidates += [
            _object_candidate(place, rating, index == thing)
            for index, (place, rating) in enumerate(
                zip(scene.proposals, ratings[chosen], strict=True)
            )
        ]
    nobody = _Rating(0.0, "no_person", "there is nobody to use it")
    candidates += [_object_candidate(place, nobody, chosen=False) for place in unplaced]
    return Choice(
        scene and scene.person,
        None if scene is None or thing is None else scene.proposals[thing].seen,
        scene and scene.pose,
        tuple(candidates),
        max(len(scenes) - 1, 0),
    )


# ------------------------------------------------------------------------------------- people


def screen_people(
    people: Sequence[DetectedBox], config: DetectConfig, hints: Hints = NO_HINTS
) -> list[str]:
    """Why each is out of the question; empty for those who are not."""
    verdicts = [_screen_person(index, people, config, hints) for index in range(len(people))]
    left = [index for index, verdict in enumerate(verdicts) if not verdict]
    left.sort(key=lambda index: people[index].box[0] + people[index].box[2])
    meant = left
    if hints.person_point is not None:
        around = [index for index in left if holds(people[index].box, hints.person_point)]
        meant = sorted(around, key=lambda index: area(people[index].box))[:1]
    elif hints.person is not None:
        meant = left[hints.person - 1 : hints.person]
    for index in set(left) - set(meant):
        verdicts[index] = "not_the_person_asked_for"
    return verdicts


def _screen_person(
    index: int, people: Sequence[DetectedBox], config: DetectConfig, hints: Hints
) -> str:
    item = people[index]
    if item.score < config.person_threshold:
        return "below_threshold"
    certain = [other for other in people if other.score >= config.person_threshold]
    if _shares_place_with_surer(item, certain, config):
        return "same_person"
    if hints.person_point is not None:
        return ""  # however small
    whole = [other for other in certain if not _shares_place_with_surer(other, certain, config)]
    largest = max((area(other.box) for other in whole), default=0.0)
    return "background_person" if area(item.box) < config.rival_area * largest else ""


def _shares_place_with_surer(
    item: DetectedBox, people: Sequence[DetectedBox], config: DetectConfig
) -> bool:
    return any(
        other.score > item.score and _share(item.box, other.box) >= config.same_person
        for other in people
    )


def plainest(people: Sequence[DetectedBox], verdicts: Sequence[str], count: int) -> list[int]:
    """Indices of at most `count` people who are not out, the surest and largest first."""
    left = [index for index, verdict in enumerate(verdicts) if not verdict]
    return sorted(left, key=lambda index: (-_plainness(people[index]), index))[:count]


def _plainness(person: DetectedBox) -> float:
    return person.score * area(person.box)


def _share(first: Box, second: Box) -> float:
    """Shared area as a share of the smaller box."""
    smaller = min(area(first), area(second))
    return shared_area(first, second) / smaller if smaller > 0 else 1.0


def holds(box: Box, point: Sequence[float]) -> bool:
    """Whether the point lies in the box."""
    return box[0] <= point[0] <= box[2] and box[1] <= point[1] <= box[3]


def _person_candidate(
    person: DetectedBox, verdict: str, scene: Scene | None, plausible: int
) -> Candidate:
    if not verdict:
        taken = scene is not None and scene.person is person
        verdict = CHOSEN if taken else "other_person"
    reason = {
        CHOSEN: "the only plausible person"
        if plausible == 1
        else f"goes best with an object among {plausible} plausible people",
        "other_person": "another one goes better with an object, or is plainer",
        "below_threshold": "the score is too low",
        "same_person": "shares its place with a surer person",
        "background_person": "much smaller than the largest person",
    }.get(verdict, verdict.replace("_", " "))
    return Candidate(
        label=person.label,
        score=person.score,
        box=person.box,
        verdict=verdict,
        reason=reason,
        source=person.source,
    )


# ------------------------------------------------------------------------------------ objects


def _rate(
    place: Proposal, scene: Scene, category: str, config: DetectConfig, hints: Hints
) -> _Rating:
    box, person = place.seen.box, scene.person.box
    told = f"evidence {place.evidence:.2f} of {place.looks} looks"
    if place.unnamed:
        told += ", none of which names such a thing"
    if hints.object_point is not None:
        at = holds(box, hints.object_point)
        return _Rating(place.evidence if at else 0.0, "" if at else "not_at_the_point", told)
    if hints.object_box is not None:
        return _Rating(place.evidence, "", "drawn by the user")
    named = category not in ANY_CATEGORY
    evidence = place.evidence
    if overlap(person, box) >= config.same_thing:
        told += "; the box is the person's"
        if not named or place.unnamed:
            return _Rating(0.0, "same_as_person", told)
        evidence *= config.same_thing_weight
    away = gap(person, box) / max(longer_side(person), 1e-9)
    if away >= config.reach:
        return _Rating(0.0, "too_far_from_person", f"{told}; {away:.2f} person lengths away")
    if not named and place.seen.score < config.unnamed_threshold:
        return _Rating(place.evidence, "below_threshold", f"{told}; no look is sure of it")
    size, contact, use = 1.0, 1 - away / config.reach, 1.0
    why = f"{told} x nearness {contact:.2f}"
    if scene.pose is not None:
        known = expectation(category if named else place.seen.label)
        touch = touch_points(scene.pose, person, config.touch)
        distance, part = distance_m(box, touch, known.touches if known else _EVERYWHERE)
        contact = nearness(distance, config.touch)
        why = f"{told} x contact {contact:.2f} ({part.replace('_', ' ')} at {distance:.2f} m)"
        if known:
            size = plausible_size(box, touch, known, config.touch)
            extent = longer_side(box) / touch.pixels_per_metre
            why = f"{why} x size {size:.2f} ({extent:.2f} m)"
    if scene.in_use is not None:
        share = scene.share_in_use(box)
        use = config.unused_weight + (1 - config.unused_weight) * share
        why = f"{why} x use {use:.2f} (of what the person uses, {share:.0%} lies there)"
    value = evidence * contact * size * use
    # contact tells which one is meant, not whether it is one
    out = "below_threshold" if evidence * size < config.object_threshold else ""
    return _Rating(value, out, f"rated {value:.2f}: {why}")


def _object_candidate(place: Proposal, rating: _Rating, chosen: bool) -> Candidate:
    verdict = CHOSEN if chosen else rating.verdict or "other_object"
    return Candidate(
        label=place.seen.label,
        score=place.seen.score,
        box=place.seen.box,
        verdict=verdict,
        reason=rating.reason,
        source=place.seen.source,
    )


# ----------------------------------------------------------------------------------- failures


def person_failure(
    people: Sequence[DetectedBox], config: DetectConfig, hints: Hints = NO_HINTS
) -> FrameFailure:
    """Why there is no person: the best one that was seen, if any."""
    found = sum(item.score >= config.person_threshold for item in people)
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
    best = max((item.score for item in people), default=None)
    seen = "no person at all" if best is None else f"at best one scoring {best:.2f}"
    return FrameFailure(
        "no_person_detected",
        f"the detector sees {seen}; the threshold is {config.person_threshold}",
    )


def object_failure(
    choice: Choice,
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
    seen = [item for item in choice.candidates if item.label in weights]
    if not seen:
        reason = "the detectors see none"
    else:
        best = max(seen, key=lambda item: item.score * weights[item.label])
        reason = f"the best box ({best.label}, score {best.score:.2f}) is out: {best.reason}"
    noun, advice = category, "; a box of the object in objects.yaml settles it"
    if category in ANY_CATEGORY:
        noun, advice = "sure object", "; name the object (objects.yaml), and less is enough"
    return FrameFailure(
        "no_object_detected",
        f"no {noun} next to the person: {reason}; "
        f"the threshold is {config.object_threshold}{advice}",
    )
