"""The recorded answers: three small CSV tables, one row per answer, each with its source."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from hoi.errors import AssetError

RECORDED: Path = Path(__file__).parents[1] / "data" / "priors"
"""The tables that come with the package."""

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


@dataclass(frozen=True)
class PriorTables:
    """Every recorded answer."""

    sizes: dict[str, SizeAnswer]
    contacts: dict[tuple[str, str], tuple[ContactAnswer, ...]]
    stands_on_floor: dict[tuple[str, str], bool]
    feet_on_floor: dict[tuple[str, str], bool]


def load_tables(folder: Path | None = None, paper_only: bool = False) -> PriorTables:
    """Read sizes.csv, contacts.csv and actions.csv.

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
            category=row.text("category"),
            action=row.text("action"),
            answer_object_part=row.text("answer_object_part"),
            answer_body_part=row.text("answer_body_part"),
            object_part=row.optional("object_part"),
            body_region=row.optional("body_region"),
            side=row.choice("side", ("", "left", "right", "both", "either")),
            probability=row.number("probability"),
            source=row.text("source"),
            note=row.optional("note"),
        )
        if not 0 <= answer.probability <= 1:
            raise row.error("probability", f"{answer.probability} is not between 0 and 1")
        if kept(answer):
            contacts.setdefault((answer.category, answer.action), []).append(answer)

    stands: dict[tuple[str, str], bool] = {}
    feet: dict[tuple[str, str], bool] = {}
    for row in _Table(folder / "actions.csv"):
        key = row.text("category"), row.text("action")
        stands[key] = row.choice("stands_on_floor", ("yes", "no")) == "yes"
        feet[key] = row.choice("feet_on_floor", ("yes", "no")) == "yes"
    return PriorTables(sizes, {key: tuple(rows) for key, rows in contacts.items()}, stands, feet)


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

    def choice(self, column: str, allowed: tuple[str, ...]) -> str:
        value = self.optional(column)
        if value not in allowed:
            raise self.error(column, f"{value!r} is none of {', '.join(map(repr, allowed))}")
        return value


class _Table:
    def __init__(self, path: Path):
        self._path = path

    def __iter__(self):
        try:
            with open(self._path, newline="", encoding="utf-8") as stream:
                reader = csv.DictReader(stream)
                for values in reader:
                    yield _Row(self._path, reader.line_num, values)
        except FileNotFoundError:
            raise AssetError(f"{self._path}: the table of recorded answers is not there") from None
        except UnicodeDecodeError as error:
            raise AssetError(f"{self._path}: not UTF-8 text: {error}") from None
