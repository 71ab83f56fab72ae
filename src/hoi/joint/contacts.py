"""From the interaction map I to pairs of point sets: which parts are pulled together, and how.

Pure bookkeeping on names; the points are chosen in `hoi.joint.problem`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from hoi.artifacts import Contact
from hoi.joint.config import ContactRule

#: Body parts that touch in one place, wherever on the object that is.
_POINTING = ("hand", "foot", "mouth")
#: How many of a pair touch, when the answer says so.
_TOUCHING = {"left": 1.0, "right": 1.0, "either": 1.0, "both": 2.0, "": 1.5}


@dataclass(frozen=True)
class ContactPair:
    """Object parts against body parts, each side taken together as one set of points.

    Args:
        to_body: True: every object point looks for its nearest body point [3.4]; False: every body
            point looks for its nearest object point.
        weight: factor of the pair's mean.
        alternative: of all pairs with the same number only the cheapest counts; -1: always counts.
    """

    object_parts: tuple[str, ...]
    body_parts: tuple[str, ...]
    to_body: bool
    weight: float = 1.0
    alternative: int = -1


def usable_contacts(
    contacts: Iterable[Contact], object_parts: Iterable[str], body_parts: Iterable[str]
) -> tuple[list[Contact], list[str]]:
    """Contacts whose two parts exist, and one sentence for each that had to be skipped."""
    object_parts, body_parts = set(object_parts), set(body_parts)
    usable, skipped = [], []
    for contact in contacts:
        name = f"{contact.object_part}-{contact.body_part}"
        if contact.object_part not in object_parts:
            skipped.append(f"{name}: no exemplar in play has {contact.object_part}")
        elif contact.body_part not in body_parts:
            skipped.append(f"{name}: the body has no region {contact.body_part}")
        else:
            usable.append(contact)
    return usable, skipped


def paper_pairs(contacts: Iterable[Contact]) -> list[ContactPair]:
    """Every pair of the interaction map, object part to body part, weight 1 [3.4].

    An answer of unsided "hands" is one pair with both hands; "left leg" and "right leg" are two.
    """
    merged: dict[tuple[str, str], list[str]] = {}
    for contact in contacts:
        named = contact.side in ("left", "right")
        body = contact.body_part if named else _unsided(contact.body_part)
        parts = merged.setdefault((contact.object_part, body), [])
        if contact.body_part not in parts:
            parts.append(contact.body_part)
    return [
        ContactPair((object_part,), tuple(parts), to_body=True)
        for (object_part, _), parts in merged.items()
    ]


def recipe_pairs(contacts: Iterable[Contact], rule: ContactRule) -> list[ContactPair]:
    """Contacts as people make them, body part to object.

    - A hand (foot, mouth) touches in one place: its points look for the nearest point on the union
      of the likely object parts, instead of pulling each listed part onto it. When the answer does
      not ask for both of a pair, only the nearer one counts (`expected_touching`).
    - A region that carries weight is pulled to the object, and a part that it covers (the seat
      under a butt) is pulled back, too; other large regions lean: body to object, at half weight.
    Weights are multiplied by the contact's probability.
    """
    contacts = list(contacts)
    pairs: list[ContactPair] = []
    for group in _by_limb(c for c in contacts if _is_pointing(c)).values():
        best = max(contact.probability for contact in group)
        likely = [c for c in group if c.probability >= rule.likely_part * best]
        objects = _unique(contact.object_part for contact in likely)
        bodies = _unique(contact.body_part for contact in likely)
        one_of = len(bodies) > 1 and expected_touching(likely) < rule.two_hands_from
        alternative = _number(pairs) if one_of else -1
        for body in bodies:
            pairs.append(ContactPair(objects, (body,), False, best, alternative))
    for (_, object_part), group in _by_region(c for c in contacts if not _is_pointing(c)).items():
        one_of = len(group) > 1 and all(contact.side == "either" for contact in group)
        alternative = _number(pairs) if one_of else -1
        for contact in group:
            supports = contact.body_part in rule.support_parts
            weight = rule.support_weight if supports else rule.leaning_weight
            sides = (object_part,), (contact.body_part,)
            pairs.append(ContactPair(*sides, False, weight * contact.probability, alternative))
            covered = supports and object_part in rule.support_reverse_parts
            if covered and rule.support_reverse_weight > 0:
                reverse = rule.support_reverse_weight * contact.probability
                pairs.append(ContactPair(*sides, True, reverse))
    return pairs


def expected_touching(contacts: Iterable[Contact]) -> float:
    """Expected number of touching hands (feet): sum over object parts of probability x count.

    The count is 1 for `either` and a named side, 2 for `both`, 1.5 when the answer does not say.
    Two parts each held by either hand take two hands: lifting a chair by back and seat.
    """
    per_part: dict[str, float] = {}
    for contact in contacts:
        count = contact.probability * _TOUCHING[contact.side]
        per_part[contact.object_part] = max(per_part.get(contact.object_part, 0.0), count)
    return sum(per_part.values())


def _unsided(body_part: str) -> str:
    return body_part.removeprefix("left_").removeprefix("right_")


def _is_pointing(contact: Contact) -> bool:
    return _unsided(contact.body_part) in _POINTING


def _by_limb(contacts: Iterable[Contact]) -> dict[str, list[Contact]]:
    """Both hands together, unless the answer names the side."""
    groups: dict[str, list[Contact]] = {}
    for contact in contacts:
        named = contact.side in ("left", "right")
        limb = contact.body_part if named else _unsided(contact.body_part)
        groups.setdefault(limb, []).append(contact)
    return groups


def _by_region(contacts: Iterable[Contact]) -> dict[tuple[str, str], list[Contact]]:
    groups: dict[tuple[str, str], list[Contact]] = {}
    for contact in contacts:
        key = (_unsided(contact.body_part), contact.object_part)
        groups.setdefault(key, []).append(contact)
    return groups


def _unique(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))


def _number(pairs: list[ContactPair]) -> int:
    return 1 + max((pair.alternative for pair in pairs), default=-1)
