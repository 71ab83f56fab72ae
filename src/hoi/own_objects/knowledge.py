"""What must be known of an object beside its shape: size, contacts, poses and the floor.

From a user's own words, from a category that it is like, or from recorded answers.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from hoi.actions.database import PoseDatabase
from hoi.errors import ConfigError
from hoi.exemplars.vocabulary import as_part
from hoi.own_objects.description import OwnAction, OwnContact, OwnMesh, OwnObject
from hoi.priors.mapping import BODY_REGIONS, map_body_part
from hoi.priors.tables import PriorTables

GIVEN = "given"
_PAIR = ("both", "either", "left", "right")
# verbs that the pose database does not know -> whose poses show them
_LOOKS_LIKE = {
    "push": ("move table", "walk bicycle"),
    "walk": ("move table", "walk bicycle"),
    "pull": ("move suitcase",),
    "drag": ("move suitcase",),
    "roll": ("move suitcase",),
    "wear": ("backpack backpack",),
    "grab": ("hand chair", "hand table"),
    "touch": ("hand chair", "hand table"),
    "lean": ("hand table",),
    "open": ("hold cup",),
    "play": ("hold teddy",),
    "read": ("hold bowl",),
    "swing": ("throw ball",),
    "lie": ("sleep chair", "rest chair"),
}


class SpokenContact(NamedTuple):
    """``push:handle:hands`` in pieces."""

    action: str
    object: str
    body: str


def parse_contact(text: str) -> SpokenContact:
    """Pieces of ``action:object part:body part``; raises ConfigError for anything else."""
    pieces = [" ".join(piece.lower().split()) for piece in text.split(":")]
    if len(pieces) != 3 or not all(pieces):
        raise ConfigError(f"contact {text!r}: write it as action:object part:body part, as in "
                          "push:handle:hands")  # fmt: skip
    return SpokenContact(*pieces)


def body_region(text: str) -> tuple[str, str]:
    """Region of the body and side of a part in a person's words.

    "hands" are both, "hand" or "one hand" is either, "left hand" that one. Raises ConfigError for
    words that name no region.
    """
    words = text.lower().split()
    said = ""
    if words and words[0] in ("one", "a", "either"):
        said, words = "either", words[1:]
    elif words and words[0] == "both":
        said, words = "both", words[1:]
    regions = map_body_part(" ".join(words)).regions
    if not regions:
        known = sorted({region.removeprefix("left_").removeprefix("right_")
                        for region in BODY_REGIONS})  # fmt: skip
        raise ConfigError(f"the body has no part {text!r}; known: {', '.join(known)}")
    side, _, limb = regions[0].partition("_")
    if side not in ("left", "right") or not limb:
        return regions[0], ""
    if len(regions) == 1:
        return limb, side
    plural = words[-1].endswith("s") or words[-1] == "feet"
    return limb, said or ("both" if plural else "either")


def object_part(text: str, parts: Sequence[str]) -> str:
    """The mesh's part that a person's words name; raises ConfigError listing the parts."""
    word = as_part(text)
    for candidate in (word, word.removesuffix("s"), f"{word}s"):
        if candidate in parts:
            return candidate
    near = [part for part in parts if word in part or part in word]
    if len(near) == 1:
        return near[0]
    raise ConfigError(f"the mesh has no part {text!r}; its parts are {', '.join(parts)}")


def own_contact(spoken: SpokenContact, parts: Sequence[str], source: str = GIVEN) -> OwnContact:
    """The contact of a person's words; raises ConfigError for parts that do not exist."""
    region, side = body_region(spoken.body)
    part = object_part(spoken.object, parts)
    return OwnContact.model_validate(
        {"object": part, "body": region, "side": side, "source": source}
    )


def group_contacts(contacts: Iterable[tuple[str, OwnContact]]) -> dict[str, list[OwnContact]]:
    """Action -> its contacts, in the order of their first mention; doubles are left out."""
    grouped: dict[str, list[OwnContact]] = {}
    for action, contact in contacts:
        of_action = grouped.setdefault(action, [])
        if contact not in of_action:
            of_action.append(contact)
    return grouped


def stands_on_floor(action: str, tables: PriorTables) -> bool:
    """What the recorded actions of this name mostly say; without any, what its verb suggests."""
    said = Counter(on for (_, name), on in tables.stands_on_floor.items() if name == action)
    if said:
        return said[True] > said[False]
    return action.split()[0] in ("push", "pull", "drag", "roll", "walk", "sit", "lean", "ride")


def feet_on_floor(action: str, tables: PriorTables) -> bool:
    """The same for the person's feet."""
    said = Counter(on for (_, name), on in tables.feet_on_floor.items() if name == action)
    return said[True] >= said[False] if said else action.split()[0] != "ride"


def poses_for(action: str, category: str, database: PoseDatabase) -> tuple[str, ...]:
    """Whose poses show an action: none to borrow when the database knows it for the category.

    Otherwise every object with an action of that name, then what the verb looks like.
    """
    if action in database.actions_of(category):
        return ()
    same = tuple(
        f"{action} {other}"
        for other in database.all_categories()
        if action in database.actions_of(other)
    )
    return same or tuple(
        source
        for source in _LOOKS_LIKE.get(action.split()[0], ())
        if len(pose_rows(source, database))
    )


def pose_rows(source: str, database: PoseDatabase) -> list[int]:
    """Rows of the database for 'action object', ascending; empty when it has none."""
    action, _, category = source.rpartition(" ")
    rows = database.rows_of(category)
    return [int(row) for row in rows if database.actions[row] == action]


def known_poses(database: PoseDatabase) -> list[str]:
    """Every 'action object' that poses can be borrowed from."""
    return [
        f"{action} {category}"
        for category in database.all_categories()
        for action in database.actions_of(category)
    ]


def like_category(category: str, parts: Sequence[str], tables: PriorTables) -> dict[str, OwnAction]:
    """The actions of a known category whose contacts name parts that this mesh has.

    Raises ConfigError when the category is not known, or none of its contacts fit.
    """
    actions: dict[str, OwnAction] = {}
    of_category = {name: rows for (noun, name), rows in tables.contacts.items() if noun == category}
    if not of_category:
        known = sorted({noun for noun, _ in tables.contacts})
        raise ConfigError(f"nothing is recorded of {category!r}; known: {', '.join(known)}")
    for action, answers in of_category.items():
        contacts = [
            OwnContact.model_validate(
                {
                    "object": answer.object_part,
                    "body": answer.body_region,
                    "side": answer.side,
                    "probability": answer.probability,
                    "source": f"as of {category}: {answer.source}",
                }
            )
            for answer in answers
            if answer.object_part in parts and answer.body_region
        ]
        if contacts:
            actions[action] = OwnAction(
                contacts=tuple(contacts),
                poses=(f"{action} {category}",),
                stands_on_floor=tables.stands_on_floor.get((category, action), False),
                feet_on_floor=tables.feet_on_floor.get((category, action), True),
            )
    if not actions:
        wanted = sorted({a.object_part for rows in of_category.values() for a in rows} - {""})
        raise ConfigError(
            f"the contacts of {category} name its parts {', '.join(wanted)}; this mesh has "
            f"{', '.join(parts)}. Name its parts so with --part GROUP=PART, or give --contact"
        )
    return actions


def described_actions(
    contacts: Mapping[str, Sequence[OwnContact]],
    category: str,
    tables: PriorTables,
    database: PoseDatabase,
    poses: Mapping[str, Sequence[str]],
    floor: Mapping[str, bool],
) -> dict[str, OwnAction]:
    """Actions from contacts; what was not said is looked up or guessed.

    Args:
        contacts: action -> its contacts.
        poses: action -> 'action object' to borrow poses from, as the user says.
        floor: action -> whether the object stands on the floor, as the user says.

    Raises ConfigError when nobody knows what an action looks like and there are others to tell it
    from, or a borrowed pose does not exist.
    """
    for action in [*poses, *floor]:
        if action not in contacts:
            raise ConfigError(f"{action!r} has no contact; actions are {', '.join(contacts)}")
    actions = {}
    for action, pairs in contacts.items():
        sources = tuple(poses.get(action) or poses_for(action, category, database))
        missing = [source for source in sources if not pose_rows(source, database)]
        unknown = not sources and action not in database.actions_of(category)
        if missing or (unknown and len(contacts) > 1):
            what = missing[0] if missing else action
            raise ConfigError(
                f"no pose of the database shows {what!r}; say what it looks like with "
                f"--pose '{action}=<action> <object>', one of: {', '.join(known_poses(database))}"
            )
        actions[action] = OwnAction(
            contacts=tuple(pairs),
            poses=sources,
            stands_on_floor=floor.get(action, stands_on_floor(action, tables)),
            feet_on_floor=feet_on_floor(action, tables),
        )
    return actions


def merged_object(
    old: OwnObject | None, new: OwnObject, mesh_name: str, origin: OwnMesh
) -> OwnObject:
    """A description with one mesh more (or replaced), and what was newly said of the object."""
    if old is None:
        return new
    size = new if new.size_m is not None and new.size_source == GIVEN else old
    return new.model_copy(
        update={
            "size_m": size.size_m,
            "size_axis": size.size_axis,
            "size_source": size.size_source,
            "detector_labels": new.detector_labels or old.detector_labels,
            "actions": {**old.actions, **new.actions},
            "meshes": {**old.meshes, mesh_name: origin},
        }
    )


def plain_words(text: str) -> str:
    """An action's name: lower-case words; raises ConfigError for anything else."""
    word = " ".join(text.lower().split())
    if not re.fullmatch(r"[a-z]+( [a-z]+)*", word):
        raise ConfigError(f"{text!r} is no action: use plain words, as in 'stand on'")
    return word
