"""Wrong answers on purpose: how much accuracy does a noisy language model cost [paper 4.1]?

People judged 29 % of GPT-3's contact pairs to be wrong. Here that share of the recorded pairs is
replaced by pairs that are true of *other* actions with the same object or mix their parts: wrong in
the way in which a model is wrong. Every frame draws anew, so that the mean over frames is a mean
over many models' errors and not the luck of one draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hoi.priors.config import LookupConfig
from hoi.priors.tables import AlternativeAnswer, ContactAnswer, PriorTables
from hoi.priors.voting import LabelledPair, distinct_answers, shares

_SOURCE = "corrupted for a study"


def corrupted(tables: PriorTables, config: LookupConfig, seed: int) -> PriorTables:
    """The tables as a model with `config.corrupt` wrong pairs would have answered them.

    With `config.votes` > 1 so many answers are drawn, each with errors of its own; a pair's
    probability is multiplied by the share of answers that name it, relative to the largest share,
    and rare pairs are left out (`config.min_share`). With `config.alternatives` set
    to ``answers`` the distinct answers become the contact sets. Errors of different answers are
    independent here, which flatters voting: what a model believes firmly, it repeats.
    """
    wrong = {category: _vocabulary(tables, category) for category, _ in tables.contacts}
    contacts: dict[tuple[str, str], tuple[ContactAnswer, ...]] = {}
    alternatives: dict[tuple[str, str], tuple[AlternativeAnswer, ...]] = {}
    for key, answers in tables.contacts.items():
        rng = np.random.default_rng([seed, *"/".join(key).encode()])
        drawn = [
            _one_answer(answers, wrong[key[0]], config.corrupt, rng) for _ in range(config.votes)
        ]
        contacts[key] = _voted(drawn, config.min_share) if config.votes > 1 else drawn[0]
        if config.alternatives == "answers":
            alternatives[key] = _as_sets(key, drawn, config.max_alternatives)
        else:
            alternatives[key] = tuple(
                replace(each, pairs=_one_answer(each.pairs, wrong[key[0]], config.corrupt, rng))
                for each in tables.alternatives.get(key, ())
            )
    return replace(
        tables, contacts=contacts, alternatives={k: v for k, v in alternatives.items() if v}
    )


def _vocabulary(tables: PriorTables, category: str) -> list[tuple[str, str, str]]:
    """Every part with every region that some action with the object uses: (part, region, side)."""
    answers = [a for (noun, _), each in tables.contacts.items() if noun == category for a in each]
    parts = dict.fromkeys(a.object_part for a in answers if a.object_part)
    regions = dict.fromkeys((a.body_region, a.side) for a in answers if a.body_region)
    return [(part, *region) for part in parts for region in regions]


def _one_answer(
    answers: Sequence[ContactAnswer],
    vocabulary: Sequence[tuple[str, str, str]],
    share: float,
    rng: np.random.Generator,
) -> tuple[ContactAnswer, ...]:
    """Each pair is replaced with probability `share` by one that is not among the true ones."""
    true = {(a.object_part, a.body_region) for a in answers}
    wrong = [pair for pair in vocabulary if pair[:2] not in true]
    given = []
    for answer in answers:
        lot, choice = rng.random(), rng.random()  # both always: draws do not depend on each other
        if lot >= share or not answer.object_part:
            given.append(answer)
        elif wrong:
            part, region, side = wrong[int(choice * len(wrong))]
            given.append(
                replace(
                    answer,
                    answer_object_part=part,
                    answer_body_part=region,
                    object_part=part,
                    body_region=region,
                    side=side,
                    source=_SOURCE,
                )
            )
    return tuple(given)


def _voted(drawn: Sequence[Sequence[ContactAnswer]], min_share: float) -> tuple[ContactAnswer, ...]:
    first: dict[tuple[str, str], ContactAnswer] = {}
    for answers in drawn:
        for answer in answers:
            first.setdefault(_parts(answer), answer)
    share = shares([[_parts(answer) for answer in answers] for answers in drawn])
    largest = max(share.values(), default=1.0)
    return tuple(
        replace(first[parts], probability=first[parts].probability * each / largest)
        for parts, each in share.items()
        if each >= min_share
    )


def _as_sets(
    key: tuple[str, str], drawn: Sequence[Sequence[ContactAnswer]], most: int
) -> tuple[AlternativeAnswer, ...]:
    by_parts = {
        _parts(answer): answer for answers in drawn for answer in answers if answer.object_part
    }
    labelled = [[_labels(a) for a in answers if a.object_part] for answers in drawn]
    return tuple(
        AlternativeAnswer(
            *key,
            name=f"answer {number}",
            probability=share,
            pairs=tuple(replace(by_parts[pair.parts], side=pair.side) for pair in pairs),
            source=_SOURCE,
        )
        for number, (pairs, share) in enumerate(distinct_answers(labelled, most), 1)
        if pairs
    )


def _parts(answer: ContactAnswer) -> tuple[str, str]:
    return answer.object_part, answer.body_region


def _labels(answer: ContactAnswer) -> LabelledPair:
    return LabelledPair(answer.object_part, answer.body_region, answer.side)
