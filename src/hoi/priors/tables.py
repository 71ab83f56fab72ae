"""The recorded answers: small CSV tables, one row per answer, each with its source.

``sizes.csv``, ``contacts.csv`` and ``actions.csv`` hold what the paper asks for. ``extents.csv``,
``alternatives.csv`` and ``arrangements.csv`` hold more, and may be absent.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, field, replace
from pathlib import Path

from hoi.errors import AssetError

NEEDED_TABLES = ("sizes", "contacts", "actions")
RICHER_TABLES = ("extents", "alternatives", "arrangements")

RECORDED: Path = Path(__file__).parents[1] / "data" / "priors"
"""The tables that come with the package."""

RELATIONS = ("front", "behind", "below", "above", "beside")
FACINGS = ("same", "opposite", "sideways")

PAPER_SOURCE = "paper"
"""Sources of answers that the paper prints begin with this word."""


@dataclass(frozen=True)
class SizeAnswer:
    """How large an object is; `axis` says which extent the number measures."""

    category: str
    size_m: float
    axis: str
    source: str


@dataclass(frozen=True)
class ContactAnswer:
    """One answered pair of parts, in the answer's words and as labels (empty: no such part)."""

    category: str
    action: str
    answer_object_part: str
    answer_body_part: str
    object_part: str
    body_region: str
    side: str  # left | right | both | either | empty for parts that do not come in pairs
    probability: float
    source: str
    note: str


Range = tuple[float, float, float]
"""Low, typical and high length, metres."""


@dataclass(frozen=True)
class ExtentsAnswer:
    """How high, wide and deep an object is; None where nobody said it."""

    category: str
    height: Range | None
    width: Range | None
    depth: Range | None
    source: str


@dataclass(frozen=True)
class AlternativeAnswer:
    """One contact set of several for the same action; without pairs, nothing touches."""

    category: str
    action: str
    name: str
    probability: float
    pairs: tuple[ContactAnswer, ...]
    source: str


@dataclass(frozen=True)
class ArrangementAnswer:
    """Where the object is, how it is turned, and how probable it is that nothing touches."""

    category: str
    action: str
    relation: str
    facing: str
    no_contact: float
    source: str


@dataclass(frozen=True)
class PriorTables:
    """Every recorded answer; those about an action by (category, action)."""

    sizes: dict[str, SizeAnswer]
    contacts: dict[tuple[str, str], tuple[ContactAnswer, ...]]
    stands_on_floor: dict[tuple[str, str], bool]
    feet_on_floor: dict[tuple[str, str], bool]
    extents: dict[str, ExtentsAnswer] = field(default_factory=dict)
    alternatives: dict[tuple[str, str], tuple[AlternativeAnswer, ...]] = field(default_factory=dict)
    arrangements: dict[tuple[str, str], ArrangementAnswer] = field(default_factory=dict)


def load_tables(folder: Path | None = None, paper_only: bool = False) -> PriorTables:
    """Read the tables of a folder; the richer ones where they are.

    Args:
        folder: where they are; None for the tables of the package.
        paper_only: keep only the answers that the paper prints.

    Raises:
        AssetError: a table is missing or damaged; the message names file, line and column.
    """
    folder = RECORDED if folder is None else Path(folder)

    def kept(answer: SizeAnswer | ContactAnswer) -> bool:
        return not paper_only or answer.source.startswith(PAPER_SOURCE)

    sizes: dict[str, SizeAnswer] = {}
    for row in _Table(folder / "sizes.csv"):
        axis = row.choice("size_axis", ("longest", "height"))
        size = SizeAnswer(row.text("category"), row.number("size_m"), axis, row.text("source"))
        if size.category in sizes:
            raise row.error("category", f"{size.category} appears twice")
        if not 0 < size.size_m < 20:
            raise row.error("size_m", f"{size.size_m} is not a plausible size in metres")
        if kept(size):
            sizes[size.category] = size

    contacts: dict[tuple[str, str], list[ContactAnswer]] = {}
    for row in _Table(folder / "contacts.csv"):
        answer = ContactAnswer(
            **_pair(row),
            answer_object_part=row.text("answer_object_part"),
            answer_body_part=row.text("answer_body_part"),
            probability=row.share("probability"),
        )
        if kept(answer):
            contacts.setdefault((answer.category, answer.action), []).append(answer)

    stands: dict[tuple[str, str], bool] = {}
    feet: dict[tuple[str, str], bool] = {}
    for row in _Table(folder / "actions.csv"):
        key = row.text("category"), row.text("action")
        stands[key] = row.choice("stands_on_floor", ("yes", "no")) == "yes"
        feet[key] = row.choice("feet_on_floor", ("yes", "no")) == "yes"
    tables = PriorTables(sizes, {key: tuple(rows) for key, rows in contacts.items()}, stands, feet)
    if paper_only:  # the paper prints nothing of the kind
        return tables
    return replace(
        tables,
        extents=_extents(folder / "extents.csv"),
        alternatives=_alternatives(folder / "alternatives.csv"),
        arrangements=_arrangements(folder / "arrangements.csv"),
    )


def _extents(path: Path) -> dict[str, ExtentsAnswer]:
    found: dict[str, ExtentsAnswer] = {}
    for row in _Table(path, optional=True):
        category = row.text("category")
        if category in found:
            raise row.error("category", f"{category} appears twice")
        answer = ExtentsAnswer(
            category,
            height=row.range("height"),
            width=row.range("width"),
            depth=row.range("depth"),
            source=row.text("source"),
        )
        if not (answer.height or answer.width or answer.depth):
            raise row.error("height", "neither height nor width nor depth is given")
        found[category] = answer
    return found


def _alternatives(path: Path) -> dict[tuple[str, str], tuple[AlternativeAnswer, ...]]:
    """One row a pair; rows of the same set follow each other and agree in its probability."""
    found: dict[tuple[str, str], dict[str, AlternativeAnswer]] = {}
    for row in _Table(path, optional=True):
        pair = _pair(row)
        sets = found.setdefault((pair["category"], pair["action"]), {})
        name, probability = row.text("set"), row.share("probability")
        known = sets.get(name)
        if known is not None and known.probability != probability:
            raise row.error("probability", f"the rows of the set {name!r} disagree")
        answer = ContactAnswer(
            **pair,
            answer_object_part=pair["object_part"],
            answer_body_part=pair["body_region"],
            probability=1.0,
        )
        pairs = (*(known.pairs if known else ()), *([answer] if pair["object_part"] else []))
        sets[name] = AlternativeAnswer(
            pair["category"], pair["action"], name, probability, pairs, pair["source"]
        )
    return {
        key: tuple(sorted(sets.values(), key=lambda each: -each.probability))
        for key, sets in found.items()
    }


def _arrangements(path: Path) -> dict[tuple[str, str], ArrangementAnswer]:
    found: dict[tuple[str, str], ArrangementAnswer] = {}
    for row in _Table(path, optional=True):
        key = row.text("category"), row.text("action")
        if key in found:
            raise row.error("action", f"{' '.join(key)} appears twice")
        found[key] = ArrangementAnswer(
            *key,
            relation=row.choice("relation", ("", *RELATIONS)),
            facing=row.choice("facing", ("", *FACINGS)),
            no_contact=row.share("no_contact"),
            source=row.text("source"),
        )
    return found


def _pair(row: _Row) -> dict[str, str]:
    return {
        "category": row.text("category"),
        "action": row.text("action"),
        "object_part": row.optional("object_part"),
        "body_region": row.optional("body_region"),
        "side": row.choice("side", ("", "left", "right", "both", "either")),
        "source": row.text("source"),
        "note": row.optional("note"),
    }


class _Row:
    def __init__(self, path: Path, line: int, values: dict[str, str | None]):
        self._path, self._line, self._values = path, line, values

    def error(self, column: str, problem: str) -> AssetError:
        return AssetError(f"{self._path}, line {self._line}, column {column}: {problem}")

    def optional(self, column: str) -> str:
        if self._values.get(column) is None:
            raise self.error(column, "the column is missing")
        return str(self._values[column]).strip()

    def text(self, column: str) -> str:
        value = self.optional(column)
        if not value:
            raise self.error(column, "is empty")
        return value

    def number(self, column: str) -> float:
        try:
            return float(self.text(column))
        except ValueError:
            raise self.error(column, f"{self.text(column)!r} is not a number") from None

    def share(self, column: str) -> float:
        value = self.number(column)
        if not 0 <= value <= 1:
            raise self.error(column, f"{value} is not between 0 and 1")
        return value

    def range(self, axis: str) -> Range | None:
        """Columns <axis>_low, <axis>_m and <axis>_high; None when all are empty."""
        columns = f"{axis}_low", f"{axis}_m", f"{axis}_high"
        if not any(self.optional(column) for column in columns):
            return None
        low, typical, high = (self.number(column) for column in columns)
        if not 0 < low <= typical <= high < 20:
            raise self.error(columns[1], f"{low}, {typical}, {high} are no lengths in order")
        return low, typical, high

    def choice(self, column: str, allowed: tuple[str, ...]) -> str:
        value = self.optional(column)
        if value not in allowed:
            raise self.error(column, f"{value!r} is none of {', '.join(map(repr, allowed))}")
        return value


class _Table:
    def __init__(self, path: Path, optional: bool = False):
        self._path, self._optional = path, optional

    def __iter__(self):
        if self._optional and not self._path.exists():
            return
        try:
            with open(self._path, newline="", encoding="utf-8") as stream:
                reader = csv.DictReader(stream)
                for values in reader:
                    row = _Row(self._path, reader.line_num, values)
                    if None in values:
                        raise row.error(
                            "after the last", "more values than columns; quote texts with commas"
                        )
                    yield row
        except FileNotFoundError:
            raise AssetError(f"{self._path}: the table of recorded answers is not there") from None
        except UnicodeDecodeError as error:
            raise AssetError(f"{self._path}: not UTF-8 text: {error}") from None
