"""The action space: what ConceptNet says an object is used for [paper 3.2].

The file is a table of edges, one row each: category, noun, relation (UsedFor or RelatedTo; the
paper's "RelatedTerms"), the other end of the edge as ConceptNet writes it, the weight, and the
reviewed action that it stands for.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from hoi.errors import AssetError

DEFAULT_ACTION_SPACE: Path = Path(__file__).parents[1] / "data" / "conceptnet" / "actions.tsv"
"""The reviewed edges that come with the package."""

RELATIONS = ("UsedFor", "RelatedTo", "Given")  # Given: the owner of an object says so
COLUMNS = ("category", "noun", "relation", "phrase", "weight", "action")


@dataclass(frozen=True)
class Edge:
    """One ConceptNet edge between an object and something people do with it."""

    category: str
    noun: str
    relation: str
    phrase: str
    weight: float
    action: str


@dataclass(frozen=True)
class ActionSpace:
    """The edges that are strong enough to count."""

    edges: tuple[Edge, ...]

    def actions_of(self, category: str) -> dict[str, float]:
        """Action -> weight of its heaviest edge, heaviest first."""
        weights: dict[str, float] = {}
        for edge in self.edges:
            if edge.category == category:
                weights[edge.action] = max(edge.weight, weights.get(edge.action, 0.0))
        return dict(sorted(weights.items(), key=lambda item: (-item[1], item[0])))

    def default_action(self, category: str, among: list[str]) -> str:
        """The heaviest action of a category that is among those the caller can use.

        Returns an empty text when there is none.
        """
        return next((name for name in self.actions_of(category) if name in among), "")


def load_action_space(path: Path | str, min_weight: float = 1.0) -> ActionSpace:
    """Read the edges of at least `min_weight`; raises AssetError naming file and line."""
    edges: list[Edge] = []
    try:
        with open(path, newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream, delimiter="\t", quoting=csv.QUOTE_NONE)
            if tuple(reader.fieldnames or ()) != COLUMNS:
                raise AssetError(f"{path}: its columns must be {', '.join(COLUMNS)}")
            for row in reader:
                edges.append(_edge(path, reader.line_num, row))
    except FileNotFoundError:
        raise AssetError(f"{path}: no action space there") from None
    except UnicodeDecodeError as error:
        raise AssetError(f"{path}: not UTF-8 text: {error}") from None
    return ActionSpace(tuple(edge for edge in edges if edge.weight >= min_weight))


def _edge(path: Path | str, line: int, row: dict[str, str | None]) -> Edge:
    empty = [column for column in COLUMNS if not row.get(column)]
    if empty:
        raise AssetError(f"{path}, line {line}: {', '.join(empty)} is empty")
    values = {column: str(row[column]) for column in COLUMNS}
    if values["relation"] not in RELATIONS:
        raise AssetError(f"{path}, line {line}: relation {values['relation']!r} is not used here")
    try:
        weight = float(values.pop("weight"))
    except ValueError:
        raise AssetError(f"{path}, line {line}: the weight is not a number") from None
    return Edge(weight=weight, **values)
