"""From many answers to one question: shares, and the different answers that were given."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Sequence
from typing import NamedTuple, TypeVar

K = TypeVar("K", bound=Hashable)


class LabelledPair(NamedTuple):
    """Labels of one contact pair; an empty label means that nothing fits the answer's word."""

    object_part: str
    body_region: str
    side: str = ""

    @property
    def parts(self) -> tuple[str, str]:
        """What two answers must agree in: which hand is a matter of degree."""
        return self.object_part, self.body_region


def shares(answers: Sequence[Iterable[K]]) -> dict[K, float]:
    """Share of the answers that name each item, most frequent first, then as first named.

    Naming an item twice in one answer counts once.
    """
    counts = Counter(item for answer in answers for item in dict.fromkeys(answer))
    return {item: count / len(answers) for item, count in counts.most_common()}


def merged_sides(answer: Iterable[LabelledPair]) -> dict[tuple[str, str], LabelledPair]:
    """One pair for each two parts of an answer: left leg and right leg are both legs."""
    merged: dict[tuple[str, str], LabelledPair] = {}
    for pair in answer:
        known = merged.get(pair.parts, pair)
        both = {known.side, pair.side} == {"left", "right"}
        merged[pair.parts] = known._replace(side="both") if both else known
    return merged


def distinct_answers(
    answers: Sequence[Sequence[LabelledPair]], most: int
) -> list[tuple[tuple[LabelledPair, ...], float]]:
    """The different sets of pairs that were answered, with their shares, most frequent first.

    Order within an answer does not count, nor does which hand; the first such answer speaks.
    """
    first: dict[frozenset[tuple[str, str]], tuple[LabelledPair, ...]] = {}
    counts: Counter[frozenset[tuple[str, str]]] = Counter()
    for answer in answers:
        merged = merged_sides(answer)
        first.setdefault(frozenset(merged), tuple(merged.values()))
        counts[frozenset(merged)] += 1
    return [(first[parts], count / len(answers)) for parts, count in counts.most_common(most)]


def verdict(share: float, correct_above: float = 0.6, incorrect_below: float = 0.4) -> str:
    """The paper's buckets [4.1]: more than 6 of 10 votes correct, fewer than 4 incorrect."""
    # ten votes of which six agree are 0.6 up to rounding, and not more than it
    if share > correct_above + 1e-9:
        return "correct"
    return "incorrect" if share < incorrect_below - 1e-9 else "uncertain"
