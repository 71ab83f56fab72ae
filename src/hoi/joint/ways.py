"""The ways in which one action may be done: each contact set of the prior is tried by itself.

The paper pulls the hands to every listed part at once, and names this as its limit: "while carrying
a chair, one can hold on the seat or the back".
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from hoi.artifacts import Interaction


class Way(NamedTuple):
    """An interaction with one contact set; `name` is empty for the list of the interaction."""

    name: str
    interaction: Interaction


def ways_of(interaction: Interaction, contact_sets: Literal["one", "alternatives"]) -> list[Way]:
    """The listed contacts first, then the alternatives that differ from what is already there.

    The probability of a way is that of the action times that of the set, so that a rare set needs a
    better loss.
    """
    ways = [Way("", interaction)]
    if contact_sets == "one":
        return ways
    tried = [_what_touches(interaction)]
    for each in interaction.alternatives:
        changed = interaction.model_copy(
            update={
                "contacts": each.contacts,
                "probability": interaction.probability * each.probability,
            }
        )
        if _what_touches(changed) not in tried:
            tried.append(_what_touches(changed))
            ways.append(Way(each.name, changed))
    return ways


def _what_touches(interaction: Interaction) -> frozenset[tuple[str, str, str]]:
    return frozenset((c.object_part, c.body_part, c.side) for c in interaction.contacts)
