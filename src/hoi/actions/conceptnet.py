"""ConceptNet 5's dump -> the few edges that the action space needs [paper 3.2].

The dump (``conceptnet-assertions-5.7.0.csv.gz``, 34 million lines, CC BY-SA 4.0) is read once from
front to end in constant memory. A line is looked at only when its first characters name one of the
relations; its JSON is parsed only when one end is a noun that is wanted.
"""

from __future__ import annotations

import csv
import gzip
import io
import json
import re
import sys
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from hoi.actions.space import COLUMNS, DEFAULT_ACTION_SPACE, RELATIONS, load_action_space
from hoi.errors import AssetError

PERSON_VERBS: Path = DEFAULT_ACTION_SPACE.parent / "verbs.tsv"
"""Verbs of what people do with objects, which other objects than the reviewed ones need."""

_REPORT_LINES = 2_000_000
_CHUNK = 1 << 22  # bytes that are decompressed at a time
_MAX_LINE = 1 << 20
_WORD = re.compile(r"[a-z]+")
#: Light verbs and fillers that phrases begin with: "to sit on" says sit.
_FILLERS = frozenset(
    ("to", "a", "an", "the", "you", "it", "being", "be", "for", "go", "get", "your")
)


@dataclass(frozen=True)
class DumpEdge:
    """One edge between a wanted noun and another English term."""

    noun: str
    relation: str
    phrase: str
    weight: float


@dataclass
class ReadCount:
    """What a pass over a dump saw."""

    lines: int = 0
    seconds: float = 0.0
    damaged: int = 0

    @property
    def lines_per_second(self) -> float:
        return self.lines / max(self.seconds, 1e-9)


def read_dump(
    path: Path | str,
    nouns: Iterable[str],
    count: ReadCount,
    report: Callable[[str], None] = lambda _: None,
    min_weight: float = 1.0,
) -> Iterator[DumpEdge]:
    """The edges of the wanted relations whose start is a wanted noun; of RelatedTo, either end.

    Args:
        path: the dump, gzipped or plain; tab-separated uri, relation, start, end, JSON.
        nouns: English nouns, spaces allowed.
        count: filled while reading.
        report: told how far it is, every two million lines.
        min_weight: lighter edges are left out [3.2: 1].
    Raises:
        AssetError: the file is absent, no ConceptNet dump or cut short; the message names the line.
    """
    path = Path(path)
    wanted = {f"/c/en/{noun.replace(' ', '_')}".encode(): noun for noun in nouns}
    heads = tuple(f"/a/[/r/{relation}/,".encode() for relation in RELATIONS)
    started = time.perf_counter()
    next_report = _REPORT_LINES
    for lines in _line_blocks(path):
        for line in lines:
            if not line.startswith(heads):
                continue
            edge = _edge(line, wanted)
            if edge is None:
                continue
            found = _weighted(*edge, count)
            if found is not None and found.weight >= min_weight:
                yield found
        if count.lines == 0 and lines and not lines[0].startswith(b"/a/["):
            raise AssetError(
                f"{path}, line 1: begins with {lines[0][:40]!r}, expected '/a/[/r/...'; is this "
                "conceptnet-assertions-5.*.csv.gz?"
            )
        count.lines += len(lines)
        count.seconds = time.perf_counter() - started
        if count.lines >= next_report:
            next_report += _REPORT_LINES
            report(f"{count.lines:,} lines, {count.lines_per_second:,.0f} a second")


def _line_blocks(path: Path) -> Iterator[list[bytes]]:
    """The file's lines, a few megabytes at a time."""
    try:
        with path.open("rb") as probe:
            zipped = probe.read(2) == b"\x1f\x8b"
        with gzip.open(path, "rb") if zipped else path.open("rb") as stream:
            rest = b""
            while block := stream.read(_CHUNK):
                *lines, rest = (rest + block).split(b"\n")
                if len(rest) > _MAX_LINE:
                    raise AssetError(
                        f"{path}: a line of over {_MAX_LINE} bytes; no ConceptNet dump"
                    )
                yield lines
            if rest:
                yield [rest]
    except FileNotFoundError:
        raise AssetError(f"{path}: no such file") from None
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise AssetError(f"{path}: damaged or not downloaded to its end: {error}") from error
    except OSError as error:
        raise AssetError(f"{path}: {error}") from error


def _edge(line: bytes, wanted: Mapping[bytes, str]) -> tuple[str, str, bytes, bytes] | None:
    """noun, relation, the other end, JSON of a line that names a wanted noun."""
    fields = line.split(b"\t", 4)
    if len(fields) != 5:
        return None
    _, relation, start, end, described = fields
    name = relation.decode("ascii", "replace").removeprefix("/r/")
    noun = wanted.get(_term(start))
    if noun is not None and end.startswith(b"/c/en/"):
        return noun, name, end, described
    # RelatedTo has no direction
    noun = wanted.get(_term(end)) if name == "RelatedTo" else None
    if noun is not None and start.startswith(b"/c/en/"):
        return noun, name, start, described
    return None


def _term(uri: bytes) -> bytes:
    """``/c/en/chair/n/wn/artifact`` -> ``/c/en/chair``."""
    return b"/".join(uri.split(b"/", 4)[:4])


def _weighted(
    noun: str, relation: str, other: bytes, described: bytes, count: ReadCount
) -> DumpEdge | None:
    """The edge with its weight, or None for one that is damaged."""
    try:
        weight = float(json.loads(described)["weight"])
        phrase = _term(other).decode("utf-8").removeprefix("/c/en/").replace("_", " ")
    except (ValueError, KeyError, TypeError, RecursionError):
        count.damaged += 1
        return None
    if not phrase or any(ord(letter) < 32 for letter in phrase):
        count.damaged += 1
        return None
    return DumpEdge(noun, relation, phrase, weight)


# ------------------------------------------------------------------------------- action space


def verbs_of(reviewed: Path | str = DEFAULT_ACTION_SPACE) -> dict[str, str]:
    """Verb -> the action it stands for: of the reviewed phrases, else of :data:`PERSON_VERBS`.

    Where phrases with one verb disagree, the action that is that verb wins, else the more frequent.
    """
    readings: dict[str, dict[str, int]] = {}
    for edge in load_action_space(reviewed, min_weight=0.0).edges:
        verb = _verb(edge.phrase)
        if verb:
            counts = readings.setdefault(verb, {})
            counts[edge.action] = counts.get(edge.action, 0) + 1
    reviewed_verbs = {
        verb: max(sorted(counts), key=lambda action: (_verb(action) == verb, counts[action]))
        for verb, counts in readings.items()
    }
    return person_verbs() | reviewed_verbs


def person_verbs(path: Path | str = PERSON_VERBS) -> dict[str, str]:
    """Verb -> action of what a person does with the whole body or the hands; single words only."""
    table: dict[str, str] = {}
    with open(path, newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream, delimiter="\t"):
            for words in row["words"].split(","):
                if len(words.split()) == 1:
                    table.setdefault(_verb(words), row["action"])
    return table


def phrases_of(reviewed: Path | str = DEFAULT_ACTION_SPACE) -> dict[tuple[str, str], str]:
    """(category, phrase) -> action of the reviewed edges."""
    edges = load_action_space(reviewed, min_weight=0.0).edges
    return {(edge.category, edge.phrase): edge.action for edge in edges}


def nouns_of(reviewed: Path | str = DEFAULT_ACTION_SPACE) -> dict[str, str]:
    """Noun -> category of a reviewed action space."""
    edges = load_action_space(reviewed, min_weight=0.0).edges
    return {edge.noun: edge.category for edge in edges}


def action_rows(
    edges: Iterable[DumpEdge],
    categories: Mapping[str, str],
    verbs: Mapping[str, str],
    phrases: Mapping[tuple[str, str], str],
) -> list[tuple[str, ...]]:
    """Rows of an action space, sorted, one for each noun, relation and phrase.

    A phrase means what the reviewed list says it does for that category, else what its verb means
    there; phrases without such a verb ("furniture", "made of wood") are dropped.
    """
    heaviest: dict[tuple[str, str, str], DumpEdge] = {}
    for edge in edges:
        key = (edge.noun, edge.relation, edge.phrase)
        if key not in heaviest or edge.weight > heaviest[key].weight:
            heaviest[key] = edge
    rows = []
    for edge in heaviest.values():
        category = categories[edge.noun]
        action = phrases.get((category, edge.phrase)) or verbs.get(_verb(edge.phrase))
        if action is not None:
            weight = f"{edge.weight:.6g}"
            rows.append((category, edge.noun, edge.relation, edge.phrase, weight, action))
    return sorted(rows, key=lambda row: (row[0], -float(row[4]), *row))


def write_action_space(
    dump: Path | str,
    out: Path | str,
    reviewed: Path | str = DEFAULT_ACTION_SPACE,
    nouns: Mapping[str, str] | None = None,
    min_weight: float = 1.0,
) -> tuple[int, ReadCount]:
    """Read a dump and write the table that `assets.action_space` takes.

    Args:
        dump: ConceptNet's assertions.
        out: the table, tab-separated; an existing one is replaced when reading has ended.
        reviewed: action space whose nouns and verbs are looked for.
        nouns: further noun -> category.
        min_weight: lighter edges are left out.

    Returns the number of rows and what the pass saw. Raises AssetError, also when the dump has no
    edge at all.
    """
    categories = nouns_of(reviewed) | dict(nouns or {})
    count = ReadCount()
    edges = read_dump(dump, categories, count, _to_stderr, min_weight)
    rows = action_rows(edges, categories, verbs_of(reviewed), phrases_of(reviewed))
    if not rows:
        raise AssetError(f"{dump}: none of its {count.lines:,} lines is an edge that is wanted")
    text = io.StringIO()
    writer = csv.writer(text, delimiter="\t", quoting=csv.QUOTE_NONE, lineterminator="\n")
    writer.writerows([COLUMNS, *rows])
    out = Path(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = out.with_name(out.name + ".partial")
    partial.write_text(text.getvalue(), encoding="utf-8")
    partial.replace(out)
    return len(rows), count


def _verb(phrase: str) -> str:
    """The first word of a phrase that is no filler: ``to sitting on`` -> ``sit``."""
    for word in _WORD.findall(phrase.lower()):
        if word not in _FILLERS:
            return _lemma(word)
    return ""


def _lemma(word: str) -> str:
    """One text for the forms of a verb: ``sitting`` -> ``sit``, ``write`` -> ``writ``."""
    stem = word
    if len(word) > 5 and word.endswith("ing"):
        stem = word[:-3]
        if len(stem) > 2 and stem[-1] == stem[-2] and stem[-1] not in "ls":
            stem = stem[:-1]
    return stem[:-1] if len(stem) > 3 and stem.endswith("e") else stem


def _to_stderr(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
