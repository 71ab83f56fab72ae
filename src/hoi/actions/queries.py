"""What to search images for: "woman sit chair" [paper 3.2, building the interaction database]."""

from __future__ import annotations

import csv
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from hoi.actions.space import ActionSpace
from hoi.errors import ConfigError

SUBJECTS = ("woman", "man")
PEOPLE = (*SUBJECTS, "person", "girl", "boy", "child", "lady", "guy", "people", "human", "someone")


class Query(NamedTuple):
    """A search phrase in pieces; the subject may be empty."""

    subject: str
    action: str
    category: str

    def __str__(self) -> str:
        return " ".join(word for word in self if word)


def queries(space: ActionSpace, category: str, subjects: Sequence[str] = SUBJECTS) -> list[Query]:
    """Search phrases for every action of an object, heaviest action first."""
    return [
        Query(subject, action, category)
        for action in space.actions_of(category)
        for subject in subjects
    ]


def parse_query(text: str, categories: Collection[str]) -> Query:
    """Pieces of ``woman sit chair``, ``woman_sit_chair`` or ``sit chair``.

    Args:
        text: the phrase, as people name a folder.
        categories: known objects; the longest that ends the phrase is meant, else its last word.

    Raises ConfigError for a phrase without an action or an object.
    """
    words = text.lower().replace("_", " ").replace("-", " ").split()
    spelt = {name: name.replace("_", " ").split() for name in categories}
    ends = [name for name, noun in spelt.items() if words[-len(noun) :] == noun]
    category = max(ends, key=len, default=words[-1] if words else "")
    rest = words[: len(words) - len(spelt.get(category, [category]))]
    subject = rest.pop(0) if rest and rest[0] in PEOPLE else ""
    rest = [word for word in rest if word not in ("a", "an", "the")]
    if not rest or not category:
        raise ConfigError(f"{text!r} is no query: write it as 'woman sit chair'")
    return Query(subject, " ".join(rest), category)


def write_queries(
    space: ActionSpace, categories: Sequence[str], known: Collection[tuple[str, str]], path: Path
) -> None:
    """A table of search phrases: category, action, weight, in_database (yes or no), query.

    Args:
        known: (category, action) pairs that the pose database has poses of.
    """
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["category", "action", "weight", "in_database", "query"])
        for category in categories:
            weights = space.actions_of(category)
            for query in queries(space, category):
                there = "yes" if (category, query.action) in known else "no"
                weight = f"{weights[query.action]:g}"
                writer.writerow([category, query.action, weight, there, str(query)])
