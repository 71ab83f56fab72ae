"""How good are the answers? People's or models' votes on them, and who agrees with whom [4.1].

The paper asked ten people whether each label of GPT-3 is right: more than 6 votes make it correct,
fewer than 4 incorrect. The same report is made here of two kinds of votes:

- people's, from a csv file of ratings;
- a model's: asked n times, a contact pair gets one vote from every answer that names it, and a size
  one from every answer within a tolerance. No person is asked, so this measures how sure a model
  is, or how far it confirms another's labels, and not whether they are true.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from hoi.errors import AssetError
from hoi.priors.answered import ContactVote, SizeVote, contact_vote, interview_of, size_vote
from hoi.priors.client import MissingRecording
from hoi.priors.config import LanguageModelConfig, StudyConfig
from hoi.priors.tables import PAPER_SOURCE, PriorTables
from hoi.priors.voting import verdict

Pair = tuple[str, str]
Key = tuple[str, str]

STUDY_COLUMNS = (
    "subject", "labels", "voters", "kind", "n_labels", "votes_per_label", "correct_pct",
    "uncertain_pct", "incorrect_pct", "votes_for_pct", "p_value", "note",
)  # fmt: skip
AGREEMENT_COLUMNS = (
    "subject", "first", "second", "n", "same_pct", "mean_overlap", "median_factor", "note",
)  # fmt: skip
SIZE_COLUMNS = (
    "category", "size_m", "source", "reviewed_axis", "usual_height_m", "usual_longest_m",
    "factor_as_longest", "factor_as_reviewed", "in_range_as_reviewed",
)  # fmt: skip
RATING_COLUMNS = (
    "subject", "category", "action", "object_part", "body_part", "size_m", "rater", "correct",
)  # fmt: skip

PRINTED = (
    {
        "subject": "sizes", "correct_pct": 75.0, "uncertain_pct": 25.0, "incorrect_pct": 0.0,
    },
    {
        "subject": "contacts", "correct_pct": 53.81, "uncertain_pct": 16.76, "incorrect_pct": 29.43,
    },
)  # fmt: skip
"""What the paper prints of its user study [4.1]; both with p << 0.001."""


@dataclass(frozen=True)
class Voice:
    """Everything that one model says in one wording, or a table says.

    Attributes:
        sizes: category -> answered sizes, metres. contacts: (category, action) -> pair of labels ->
            share of answers. samples: answers a question.
    """

    name: str
    sizes: Mapping[str, tuple[float, ...]]
    contacts: Mapping[Key, Mapping[Pair, float]]
    samples: int
    note: str = ""


def voice_of_tables(tables: PriorTables, name: str, note: str = "") -> Voice:
    """The labels of a table, as if it had been asked once."""
    contacts = {
        key: {
            (a.object_part, a.body_region): 1.0 for a in answers if a.object_part and a.body_region
        }
        for key, answers in tables.contacts.items()
    }
    sizes = {category: (answer.size_m,) for category, answer in tables.sizes.items()}
    return Voice(name, sizes, contacts, 1, note)


def voices_of_tables(tables: PriorTables) -> tuple[Voice, Voice]:
    """The paper's printed labels, and those that fill its gaps."""
    return (
        voice_of_tables(labels_by_origin(tables, printed=True), "the paper's (GPT-3)"),
        voice_of_tables(labels_by_origin(tables, printed=False), "authored for hoi"),
    )


def voice_of_model(config: LanguageModelConfig, tables: PriorTables) -> Voice:
    """What is recorded of a model; questions that nobody recorded are left out and counted."""
    interview = interview_of(config.model_copy(update={"mode": "replay"}))
    sizes: list[SizeVote] = []
    contacts: list[ContactVote] = []
    missing = 0
    for category in tables.sizes:
        try:
            sizes.append(size_vote(interview, category))
        except MissingRecording:
            missing += 1
    for key in tables.contacts:
        try:
            contacts.append(contact_vote(interview, *key))
        except (MissingRecording, KeyError):
            missing += 1
    rejected = sum(len(vote.replies.rejected) for vote in [*sizes, *contacts])
    asked = len(sizes) + len(contacts)
    note = f"{asked} questions recorded, {missing} not; {rejected} answers rejected"
    return Voice(
        f"{config.model}, {config.prompt} prompt",
        {v.category: tuple(s.length for s in v.replies.said) for v in sizes if v.replies.said},
        {(v.category, v.action): v.shares for v in contacts if v.replies.said},
        config.samples,
        note,
    )


# ------------------------------------------------------------------------------ the study


def study_row(
    subject: str,
    labels: str,
    voters: str,
    kind: str,
    votes: Sequence[tuple[int, int]],
    config: StudyConfig,
    note: str = "",
) -> dict[str, object]:
    """One line of the report: `votes` are (for, cast) of every label.

    The binomial test is exact and one-sided: are more than half of all votes for the labels? (The
    paper does not say what its test compares. 75 % of 20 labels correct is p = 0.02 if labels are
    counted, so its p << 0.001 must count votes.)
    """  # fmt: skip
    buckets = [
        verdict(yes / cast, config.correct_above, config.incorrect_below) for yes, cast in votes
    ]
    yes, cast = sum(v for v, _ in votes), sum(n for _, n in votes)
    share = {name: 100 * buckets.count(name) / len(votes) if votes else math.nan
             for name in ("correct", "uncertain", "incorrect")}  # fmt: skip
    return {
        "subject": subject,
        "labels": labels,
        "voters": voters,
        "kind": kind,
        "n_labels": len(votes),
        "votes_per_label": cast / len(votes) if votes else math.nan,
        **{f"{name}_pct": value for name, value in share.items()},
        "votes_for_pct": 100 * yes / cast if cast else math.nan,
        "p_value": binomtest(yes, cast, 0.5, alternative="greater").pvalue if cast else math.nan,
        "note": note,
    }


def printed_rows() -> list[dict[str, object]]:
    """The paper's own figures, for comparison."""
    return [
        {"labels": "the paper's (GPT-3)", "voters": "10 people", "kind": "printed in the paper",
         "votes_per_label": 10, "note": "p << 0.001, [4.1]", **row}
        for row in PRINTED
    ]  # fmt: skip


def model_rows(voice: Voice, labels: Voice | None, config: StudyConfig) -> list[dict[str, object]]:
    """A model's votes on its own labels (`labels` None), or on another's.

    A model's own contact labels are all pairs that it names at least once; its own size is the
    median answer.
    """
    of = labels.name if labels else "its own"
    sizes, contacts = [], []
    for category, answers in voice.sizes.items():
        if labels is None:
            size = sorted(answers)[len(answers) // 2]
        elif category in labels.sizes:
            size = labels.sizes[category][0]
        else:
            continue
        near = sum(_close(answer, size, config.size_tolerance) for answer in answers)
        sizes.append((near, len(answers)))
    for key, shares in voice.contacts.items():
        pairs = shares if labels is None else labels.contacts.get(key, {})
        contacts += [(round(shares.get(p, 0.0) * voice.samples), voice.samples) for p in pairs]
    kind = "a model's answers"
    return [
        study_row(subject, of, voice.name, kind, votes, config, voice.note)
        for subject, votes in (("sizes", sizes), ("contacts", contacts))
        if votes
    ]


def rating_rows(path: Path, config: StudyConfig) -> list[dict[str, object]]:
    """The report of a csv file of people's ratings (columns RATING_COLUMNS, one row a vote).

    Raises AssetError naming line and column for a file that cannot be read so.
    """
    votes: dict[str, dict[tuple[str, ...], dict[str, bool]]] = {}
    for line, row in _lines(path):
        subject = row["subject"].strip()
        if subject not in ("size", "contact"):
            raise AssetError(
                f"{path}, line {line}, column subject: {subject!r} is no size, contact"
            )
        answer = row["correct"].strip().lower()
        if not answer and not row["rater"].strip():
            continue  # a label that nobody has rated yet
        if answer not in _YES and answer not in _NO:
            raise AssetError(
                f"{path}, line {line}, column correct: {answer!r} is neither yes nor no"
            )
        label = tuple(row[name].strip() for name in RATING_COLUMNS[1:6])
        raters = votes.setdefault(subject, {}).setdefault(label, {})
        rater = row["rater"].strip()
        if not rater or rater in raters:
            rated = repr(" ".join(filter(None, label)))
            problem = f"{rater} rates {rated} twice" if rater else "is empty"
            raise AssetError(f"{path}, line {line}, column rater: {problem}")
        raters[rater] = answer in _YES
    rows = []
    for subject, labels in sorted(votes.items(), reverse=True):
        people = {rater for raters in labels.values() for rater in raters}
        counted = [(sum(raters.values()), len(raters)) for raters in labels.values()]
        rows.append(
            study_row(
                f"{subject}s", "as rated", f"{len(people)} people", "people", counted, config,
                Path(path).name,
            )
        )  # fmt: skip
    return rows


_YES, _NO = ("yes", "y", "1", "true", "correct"), ("no", "n", "0", "false", "incorrect")


def rating_sheet(tables: PriorTables) -> list[dict[str, str]]:
    """One empty row per recorded label, for people to fill in and copy for every rater."""
    empty = dict.fromkeys(RATING_COLUMNS, "")
    rows = [
        empty | {"subject": "size", "category": category, "size_m": f"{answer.size_m:g}"}
        for category, answer in tables.sizes.items()
    ]
    for (category, action), answers in tables.contacts.items():
        rows += [
            empty | {
                "subject": "contact", "category": category, "action": action,
                "object_part": answer.answer_object_part, "body_part": answer.answer_body_part,
            }
            for answer in answers
        ]  # fmt: skip
    return rows


def study_table(
    config: StudyConfig, tables: PriorTables, voices: Sequence[Voice]
) -> list[dict[str, object]]:
    """results/priors.csv: the paper's figures, people's ratings, every recorded model."""
    paper, _ = voices_of_tables(tables)
    rows = printed_rows()
    for path in config.ratings:
        rows += rating_rows(Path(path), config)
    for voice in voices:
        rows += model_rows(voice, None, config) + model_rows(voice, paper, config)
    return rows


def labels_by_origin(tables: PriorTables, printed: bool) -> PriorTables:
    """The labels that the paper prints, or those of others that fill its gaps."""
    return PriorTables(
        {k: v for k, v in tables.sizes.items() if v.source.startswith(PAPER_SOURCE) == printed},
        {
            key: answers
            for key, answers in tables.contacts.items()
            if answers[0].source.startswith(PAPER_SOURCE) == printed
        },
        tables.stands_on_floor,
        tables.feet_on_floor,
    )


# --------------------------------------------------------------------------- who agrees


def agreement_table(voices: Sequence[Voice], config: StudyConfig) -> list[dict[str, object]]:
    """results/prior_agreement.csv: every two voices, on what both were asked.

    Sizes: share within the tolerance, and the median factor between them. Contacts: share of
    actions with the same set of pairs, and the mean overlap of the sets (intersection over union).
    The set of a voice holds the pairs that not too few of its answers name.
    """
    rows = []
    for i, first in enumerate(voices):
        for second in voices[i + 1 :]:
            rows += [
                row
                for row in (_size_agreement(first, second, config),
                            _contact_agreement(first, second, config))
                if row["n"]
            ]  # fmt: skip
    return rows


def _size_agreement(first: Voice, second: Voice, config: StudyConfig) -> dict[str, object]:
    common = [category for category in first.sizes if category in second.sizes]
    medians = [[sorted(v.sizes[c])[len(v.sizes[c]) // 2] for c in common] for v in (first, second)]
    factors = [max(a / b, b / a) for a, b in zip(*medians, strict=True)]
    same = [_close(a, b, config.size_tolerance) for a, b in zip(*medians, strict=True)]
    return {
        "subject": "sizes", "first": first.name, "second": second.name, "n": len(common),
        "same_pct": 100 * float(np.mean(same)) if same else math.nan,
        "median_factor": float(np.median(factors)) if factors else math.nan,
        "note": f"same: within {config.size_tolerance:.0%}",
    }  # fmt: skip


def _contact_agreement(first: Voice, second: Voice, config: StudyConfig) -> dict[str, object]:
    common = [key for key in first.contacts if key in second.contacts]
    least = config.incorrect_below
    overlaps = [
        overlap(_believed(first.contacts[key], least), _believed(second.contacts[key], least))
        for key in common
    ]
    return {
        "subject": "contacts", "first": first.name, "second": second.name, "n": len(common),
        "same_pct": 100 * float(np.mean([each == 1 for each in overlaps])) if common else math.nan,
        "mean_overlap": float(np.mean(overlaps)) if common else math.nan,
        "note": "labels; intersection over union of the pairs",
    }  # fmt: skip


def overlap(first: set[Pair], second: set[Pair]) -> float:
    """Intersection over union; two empty sets agree."""
    return len(first & second) / len(first | second) if first | second else 1.0


def _believed(shares: Mapping[Pair, float], least: float) -> set[Pair]:
    return {pair for pair, share in shares.items() if share >= least - 1e-9}


def _close(answer: float, size: float, tolerance: float) -> bool:
    return abs(answer - size) <= tolerance * size + 1e-9


# ------------------------------------------------------------------------ sizes by axis


def size_table(tables: PriorTables) -> list[dict[str, object]]:
    """results/prior_sizes.csv: what one number a size costs, by the extent that it is taken for.

    The paper's prompt asks for a length and is answered with heights. The factors say how much too
    large (above 1) or small an object becomes that is scaled so that its longest side, or the
    reviewed axis, has the answered size.
    """
    rows: list[dict[str, object]] = []
    for category, size in tables.sizes.items():
        extents = tables.extents.get(category)
        if extents is None:
            continue
        known = [each for each in (extents.height, extents.width, extents.depth) if each]
        longest = max(known, key=lambda each: each[1])
        measured = extents.height if size.axis == "height" and extents.height else longest
        fits = measured[0] <= size.size_m <= measured[2]
        rows.append(
            {
                "category": category,
                "size_m": size.size_m,
                "source": size.source,
                "reviewed_axis": size.axis,
                "usual_height_m": extents.height[1] if extents.height else math.nan,
                "usual_longest_m": longest[1],
                "factor_as_longest": size.size_m / longest[1],
                "factor_as_reviewed": size.size_m / measured[1],
                "in_range_as_reviewed": "yes" if fits else "no",
            }
        )
    return rows


# ------------------------------------------------------------------------------ files


def write_rows(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
    """Write a table; numbers with four digits, missing ones empty."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns, lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({name: _shown(value) for name, value in row.items()})


def _shown(value: object) -> object:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.4g}"
    return value


def _lines(path: Path) -> Iterable[tuple[int, dict[str, str]]]:
    try:
        with open(path, newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(stream)
            missing = [name for name in RATING_COLUMNS if name not in (reader.fieldnames or ())]
            if missing:
                raise AssetError(f"{path}: no column {', '.join(missing)}")
            for row in reader:
                yield reader.line_num, {name: row[name] or "" for name in RATING_COLUMNS}
    except FileNotFoundError:
        raise AssetError(f"{path}: the file of ratings is not there") from None
    except UnicodeDecodeError as error:
        raise AssetError(f"{path}: not UTF-8 text: {error}") from None
