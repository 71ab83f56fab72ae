"""What several looks at a picture say together about where the wanted object is.

A small detector that looks once names a thing wrongly more often than it overlooks it. So every
look (a detector, the whole picture or a part of it) votes for boxes: with the score of a class that
stands for the category, times 1/2 for a look-alike class, and faintly for any other class it is
not sure of. Boxes that overlap are one proposal; its evidence is ``1 - prod(1 - vote)`` over the
looks, its box the mean of theirs, weighted by the squared votes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hoi.detect.backends import Box, DetectedBox
from hoi.detect.boxes import overlap
from hoi.detect.config import EvidenceConfig
from hoi.detect.labels import PERSON, WORN


@dataclass(frozen=True)
class Look:
    """What one detector saw in one part of the picture, boxes in pixels of the whole picture.

    `window` is that part, None the whole picture.
    """

    name: str
    boxes: tuple[DetectedBox, ...]
    window: Box | None = None


@dataclass(frozen=True)
class Proposal:
    """A place where the object may be.

    `seen` has the class that speaks most for the category and its best score there, and the fused
    box; `evidence` lies in [0, 1]; `looks` is the number of looks that voted for it.
    """

    seen: DetectedBox
    evidence: float
    looks: int
    #: no look named a class that stands for the category
    unnamed: bool


@dataclass(frozen=True)
class _Vote:
    value: float
    item: DetectedBox
    look: str
    wanted: bool


def propose(
    looks: Sequence[Look],
    weights: Mapping[str, float],
    config: EvidenceConfig,
    image_size: tuple[int, int],
) -> list[Proposal]:
    """All proposals, the one with most evidence first.

    Args:
        looks: what was seen; people, and what they wear, are left out here.
        weights: detector class -> weight, see :func:`hoi.detect.labels.label_weights`.
        config: how votes are weighed.
        image_size: height and width in pixels.
    """
    votes = [
        vote
        for look in looks
        for item in look.boxes
        if (vote := _vote(item, look, weights, config, image_size)).value >= config.faintest
    ]
    votes.sort(key=lambda vote: (-vote.value, vote.item.label, vote.item.box, vote.look))
    groups: list[list[_Vote]] = []
    for vote in votes:
        home = next(
            (g for g in groups if overlap(g[0].item.box, vote.item.box) >= config.same_place), None
        )
        if home is None:
            groups.append([vote])
        else:
            home.append(vote)
    proposals = [_proposal(group) for group in groups]
    return sorted(proposals, key=lambda p: (-p.evidence, p.seen.label, p.seen.box))


def _vote(
    item: DetectedBox,
    look: Look,
    weights: Mapping[str, float],
    config: EvidenceConfig,
    image_size: tuple[int, int],
) -> _Vote:
    wanted = item.label in weights
    if wanted:
        value = weights[item.label] * item.score
    elif item.label == PERSON or item.label in WORN:
        value = 0.0
    else:  # a thing, and not surely another one
        value = config.any_class_weight * item.score * (1 - item.score)
    if look.window is not None and _cut_off(item.box, look.window, config.border, image_size):
        value *= config.cut_weight
    return _Vote(value, item, look.name, wanted)


def _cut_off(box: Box, window: Box, border: float, image_size: tuple[int, int]) -> bool:
    """Whether the box ends where the look ends, though the picture goes on."""
    height, width = image_size
    margin = border * max(window[2] - window[0], window[3] - window[1])
    return (
        (box[0] < window[0] + margin and window[0] > 0)
        or (box[1] < window[1] + margin and window[1] > 0)
        or (box[2] > window[2] - margin and window[2] < width)
        or (box[3] > window[3] - margin and window[3] < height)
    )


def _proposal(votes: Sequence[_Vote]) -> Proposal:
    """`votes` come surest first."""
    best: dict[str, _Vote] = {}
    for vote in votes:
        best.setdefault(vote.look, vote)
    values = np.array([vote.value for vote in best.values()])
    boxes = np.array([vote.item.box for vote in best.values()])
    x0, y0, x1, y1 = (round(float(v), 3) for v in (values**2 @ boxes) / (values**2).sum())
    wanted = [vote for vote in votes if vote.wanted]
    label = (wanted or votes)[0].item.label
    score = max(vote.item.score for vote in votes if vote.item.label == label)
    return Proposal(
        DetectedBox(label, score, (x0, y0, x1, y1), ", ".join(sorted(best))),
        float(1 - np.prod(1 - values)),
        len(best),
        not wanted,
    )
