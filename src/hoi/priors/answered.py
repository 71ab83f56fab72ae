"""From a model's recorded answers to the tables that the prior stage reads [paper 3.3].

The tables have the form of the reviewed ones of the package. Which model answered stands in columns
of their own, so that what follows depends on what was said and not on who said it.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path

from hoi.priors.client import LanguageModel, MissingRecording
from hoi.priors.config import LanguageModelConfig
from hoi.priors.interview import Interview, Rejection, Replies, middle
from hoi.priors.mapping import OBJECT_PARTS
from hoi.priors.prompts import AXES, ContactsSaid, NamedPair, SizeSaid
from hoi.priors.recordings import Recordings
from hoi.priors.tables import ExtentsAnswer, PriorTables, load_tables
from hoi.priors.voting import LabelledPair, distinct_answers, merged_sides, shares

_MOST_SETS = 5
_LEAST_SHARE_OF_A_SET = 0.2
Row = dict[str, object]


@dataclass(frozen=True)
class SizeVote:
    """What one model says of an object's size."""

    category: str
    replies: Replies[SizeSaid]

    @property
    def size_m(self) -> float:
        """The median answer, metres."""
        return middle([said.length for said in self.replies.said])


@dataclass(frozen=True)
class ContactVote:
    """What one model says of an action: the labels of every readable answer."""

    category: str
    action: str
    replies: Replies[ContactsSaid]
    labelled: tuple[tuple[LabelledPair, ...], ...]

    @property
    def shares(self) -> dict[tuple[str, str], float]:
        """(object part, body region) -> share of the answers that name it, labels only."""
        return shares([[p.parts for p in each if all(p.parts)] for each in self.labelled])


def size_vote(interview: Interview, category: str) -> SizeVote:
    """Ask (or replay) the size of an object."""
    return SizeVote(category, interview.size(category))


def contact_vote(interview: Interview, category: str, action: str) -> ContactVote:
    """Ask (or replay) the contacts of an action; words become labels."""
    replies = interview.contacts(category, action)
    labelled = tuple(
        tuple(interview.label(category, pair) for pair in said.pairs) for said in replies.said
    )
    return ContactVote(category, action, replies, labelled)


def interview_of(config: LanguageModelConfig, model: LanguageModel | None = None) -> Interview:
    """The interview that a configuration describes; `model` replaces its client."""
    model = model or LanguageModel(config, config.recordings)
    return Interview(model, config.prompt, config.map_parts == "model")


def questions_of(tables: PriorTables) -> tuple[list[str], list[tuple[str, str]]]:
    """What a model has to be asked to replace `tables`: objects, and actions with objects.

    Objects without part labels cannot be asked about contact: nothing would come of the answer.
    """
    return list(tables.sizes), [key for key in tables.contacts if key[0] in OBJECT_PARTS]


# ------------------------------------------------------------------------------- the tables


def measured_axis(size_m: float, extents: ExtentsAnswer | None) -> str:
    """Which extent a size measures: ``height`` or ``longest``, whichever it is nearer to.

    Asked for the length of a table, models (the paper's, too) give its height. Sizes in metres; the
    usual extents of the object decide.
    """
    if extents is None or extents.height is None:
        return "longest"
    longest = max(each[1] for each in (extents.height, extents.width, extents.depth) if each)
    to_height, to_longest = (abs(math.log(size_m / each)) for each in (extents.height[1], longest))
    return "height" if to_height <= to_longest else "longest"


def size_rows(
    votes: Iterable[SizeVote], source: str, usual: Mapping[str, ExtentsAnswer] | None = None
) -> list[Row]:
    """Rows of sizes.csv; objects without a readable answer have none.

    `usual`: extents by which the answer to a cloze is read (`measured_axis`).
    """
    rows: list[Row] = []
    for vote in votes:
        said, rejected = vote.replies.said, vote.replies.rejected
        if said:
            axis = "longest"  # the JSON prompt asks for it by this name
            if not said[0].extents:
                axis = measured_axis(vote.size_m, (usual or {}).get(vote.category))
            rows.append(
                {
                    "category": vote.category,
                    "size_m": f"{vote.size_m:.4g}",
                    "size_axis": axis,
                    "source": source,
                    "comment": _count(len(said), len(rejected)),
                }
            )
    return rows


def extent_rows(votes: Iterable[SizeVote], source: str) -> list[Row]:
    """Rows of extents.csv: medians of the low, typical and high ends that were answered."""
    rows: list[Row] = []
    for vote in votes:
        ranges = [dict(said.extents) for said in vote.replies.said if said.extents]
        if ranges:
            row: Row = {"category": vote.category}
            for axis in AXES:
                for i, end in enumerate(("low", "m", "high")):
                    row[f"{axis}_{end}"] = f"{middle([each[axis][i] for each in ranges]):.4g}"
            rows.append(row | {"source": source, "note": ""})
    return rows


def contact_rows(votes: Iterable[ContactVote], source: str) -> list[Row]:
    """Rows of contacts.csv: one per pair of labels with its share, and one per unlabelled pair."""
    return [row for vote in votes for row in _contact_rows(vote, source)]


def _contact_rows(vote: ContactVote, source: str) -> list[Row]:
    words: dict[tuple[str, ...], Counter[NamedPair]] = {}
    sides: dict[tuple[str, ...], Counter[str]] = {}
    label_of: dict[tuple[str, ...], LabelledPair] = {}
    named = []
    for said, labels in zip(vote.replies.said, vote.labelled, strict=True):
        merged = merged_sides(labels)
        keys: list[tuple[str, ...]] = []
        for pair, label in zip(said.pairs, labels, strict=True):
            # what has no label is told apart by its words
            key = label.parts if all(label.parts) else (pair.object_part, pair.body_part, "")
            words.setdefault(key, Counter())[pair] += 1
            label_of[key] = label
            if key not in keys:
                sides.setdefault(key, Counter())[merged[label.parts].side] += 1
                keys.append(key)
        named.append(keys)
    rows: list[Row] = []
    for key, share in shares(named).items():
        pair, label = words[key].most_common(1)[0][0], label_of[key]
        rows.append(
            {
                "category": vote.category,
                "action": vote.action,
                "answer_object_part": pair.object_part,
                "answer_body_part": pair.body_part,
                "object_part": label.object_part if label.body_region else "",
                "body_region": label.body_region,
                "side": sides[key].most_common(1)[0][0],
                "probability": f"{share:.4g}",
                "source": source,
                "note": "" if all(label.parts) else "no label of mesh or body fits",
            }
        )
    return rows


def alternative_rows(votes: Iterable[ContactVote], source: str) -> list[Row]:
    """Rows of alternatives.csv: the distinct answers, where a model gave more than one."""
    rows: list[Row] = []
    for vote in votes:
        usable = [[pair for pair in each if all(pair.parts)] for each in vote.labelled]
        sets = [
            (pairs, share)
            for pairs, share in distinct_answers(usable, _MOST_SETS)
            if share >= _LEAST_SHARE_OF_A_SET
        ]
        if len(sets) < 2:
            continue
        for number, (pairs, share) in enumerate(sets, 1):
            for pair in pairs or [LabelledPair("", "", "")]:
                rows.append(
                    {
                        "category": vote.category,
                        "action": vote.action,
                        "set": f"answer {number}" if pairs else "no contact",
                        "probability": f"{share:.4g}",
                        "object_part": pair.object_part,
                        "body_region": pair.body_region,
                        "side": pair.side,
                        "source": source,
                        "note": "",
                    }
                )
    return rows


def arrangement_rows(votes: Iterable[ContactVote], source: str) -> list[Row]:
    """Rows of arrangements.csv: most frequent relation and facing, share of "nothing touches"."""
    rows: list[Row] = []
    for vote in votes:
        said = vote.replies.said
        none = sum(not each.pairs for each in said) / len(said) if said else 0.0
        relation = Counter(each.relation for each in said).most_common(1)
        facing = Counter(each.facing for each in said).most_common(1)
        if said and (none > 0 or relation[0][0] or facing[0][0]):
            rows.append(
                {
                    "category": vote.category,
                    "action": vote.action,
                    "relation": relation[0][0],
                    "facing": facing[0][0],
                    "no_contact": f"{none:.4g}",
                    "source": source,
                    "note": "",
                }
            )
    return rows


def rejected_rows(sizes: Iterable[SizeVote], contacts: Iterable[ContactVote]) -> list[Row]:
    """Answers that could not be read, twice, with the reason."""

    def row(category: str, action: str, rejection: Rejection) -> Row:
        return {
            "category": category,
            "action": action,
            "template": rejection.template,
            "sample": rejection.sample,
            "answer": " ".join(rejection.answer.split())[:200],
            "reason": rejection.reason,
        }

    rows = [row(v.category, "", r) for v in sizes for r in v.replies.rejected]
    return rows + [row(v.category, v.action, r) for v in contacts for r in v.replies.rejected]


# --------------------------------------------------------------------------- the whole folder


def write_tables(
    config: LanguageModelConfig, recorded: Path, folder: Path, model: LanguageModel | None = None
) -> None:
    """Write every table of the prior stage from a model's answers.

    Args:
        config: model, prompt, samples, and what to do about gaps.
        recorded: the package's tables: they say what to ask, what stands on the floor, and fill
            gaps where `config.gaps` says so.
        folder: where the tables go, and ``rejected.csv`` beside them.
        model: replaces the client that the configuration describes.

    Raises:
        MissingRecording: in replay mode, for a question that nobody recorded, if gaps stop.
    """
    tables = load_tables(recorded)
    categories, actions = questions_of(tables)
    interview = interview_of(config, model)
    sizes, contacts = [], []
    for category in categories:
        with _gaps_allowed(config):
            sizes.append(size_vote(interview, category))
    for key in actions:
        with _gaps_allowed(config):
            contacts.append(contact_vote(interview, *key))
    source = f"language model ({config.prompt} prompt)"
    who = {"model": config.model}
    made = {
        "sizes": size_rows(sizes, source, tables.extents),
        "contacts": contact_rows(contacts, source),
        "extents": extent_rows(sizes, source),
        "alternatives": alternative_rows(contacts, source),
        "arrangements": arrangement_rows(contacts, source),
    }
    # a gap is a question without a readable answer, not a pair that was not named; who answers
    # about contact answers about its alternatives, too, and only the JSON prompt asks for ranges
    of_sizes = {(vote.category,) for vote in sizes if vote.replies.said}
    of_actions = {(vote.category, vote.action) for vote in contacts if vote.replies.said}
    of_extents = {(str(row["category"]),) for row in made["extents"]}
    answered = {"sizes": of_sizes, "extents": of_extents}
    folder.mkdir(parents=True, exist_ok=True)
    for name, rows in made.items():
        columns, reviewed = _read(recorded / f"{name}.csv")
        keys = ("category",) if name in answered else ("category", "action")
        filled = answered.get(name, of_actions)
        rows = [row | who for row in rows]
        if config.gaps == "recorded":
            for row in reviewed:
                if tuple(row[key] for key in keys) not in filled:
                    rows.append({**row, "model": ""})
        _write(folder / f"{name}.csv", [*columns, "model"], rows)
    columns, rows = _read(recorded / "actions.csv")
    _write(folder / "actions.csv", columns, rows)
    rejected = rejected_rows(sizes, contacts)
    _write(
        folder / "rejected.csv",
        ["category", "action", "template", "sample", "answer", "reason"],
        rejected,
    )


def _gaps_allowed(config: LanguageModelConfig) -> AbstractContextManager[None]:
    return nullcontext() if config.gaps == "stop" else suppress(MissingRecording)


def _count(read: int, rejected: int) -> str:
    return f"{read} answers" + (f", {rejected} rejected" if rejected else "")


def _read(path: Path) -> tuple[list[str], list[Mapping[str, str]]]:
    with open(path, newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        return list(reader.fieldnames or ()), list(reader)


def _write(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def recordings_digest(config: LanguageModelConfig) -> str:
    """What the recorded answers of a model say: changes when any answer does."""
    from hoi.digest import json_digest

    recorded = Recordings(config.recordings).of_model(config.model)
    return json_digest(
        {
            question.key(): {name: each.answer for name, each in answers.items()}
            for question, answers in recorded
        }
    )
