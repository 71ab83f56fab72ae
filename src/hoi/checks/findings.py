"""Sentences about the data, and what they mean for a run."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


class Level(Enum):
    """What a finding means."""

    OK = "ok"
    ODD = "odd"  # worth knowing; the run copes
    MISSING = "missing"  # optional and absent
    STOP = "STOP"  # a run cannot start, or every frame would fail


@dataclass(frozen=True)
class Finding:
    """One sentence under one heading."""

    topic: str
    level: Level
    text: str


def ok(topic: str, text: str) -> Finding:
    """Something is there and as it should be."""
    return Finding(topic, Level.OK, text)


def odd(topic: str, text: str) -> Finding:
    """Something is unusual; frames may fail, the run does not."""
    return Finding(topic, Level.ODD, text)


def missing(topic: str, text: str) -> Finding:
    """Something optional is not there."""
    return Finding(topic, Level.MISSING, text)


def stop(topic: str, text: str) -> Finding:
    """Something without which no run gives results."""
    return Finding(topic, Level.STOP, text)


def can_start(findings: Iterable[Finding]) -> bool:
    """Whether nothing stops a run."""
    return all(finding.level is not Level.STOP for finding in findings)


def as_text(findings: Iterable[Finding]) -> str:
    """The findings by topic, in the order in which topics first appear.

    File names that are no UTF-8 are spelled out, so that the text can always be printed.
    """
    topics: dict[str, list[Finding]] = {}
    for finding in findings:
        topics.setdefault(finding.topic, []).append(finding)
    lines = []
    for topic, found in topics.items():
        lines += [topic, *(f"  {f.level.value:<8}{f.text}" for f in found), ""]
    text = "\n".join(lines).rstrip("\n")
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def share(count: int, total: int, what: str = "frames") -> str:
    """``3 of 12 frames``, or ``all 12 frames``."""
    return f"all {total} {what}" if count == total else f"{count} of {total} {what}"


def few(names: Iterable[str], limit: int = 3) -> str:
    """The first few names, and how many more there are."""
    listed = list(names)
    text = ", ".join(listed[:limit])
    return f"{text}, and {len(listed) - limit} more" if len(listed) > limit else text
