"""Asking a model everything about one object: samples, second tries, and labels for its words.

An answer that cannot be read is asked for once more, then it is set aside as rejected, with the
reason, and shown in the tables; it never becomes a prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from hoi.priors.client import LanguageModel
from hoi.priors.mapping import BODY_VOCABULARY, OBJECT_PARTS, map_body_part, map_object_part
from hoi.priors.prompts import (
    ContactsSaid,
    NamedPair,
    SizeSaid,
    body_part_prompt,
    contact_prompt,
    contact_schema,
    json_contact_prompt,
    object_part_prompt,
    read_contacts,
    read_json_contacts,
    read_json_size,
    read_label,
    read_size,
    size_prompt,
    size_schema,
)
from hoi.priors.recordings import Question
from hoi.priors.voting import LabelledPair, shares

T = TypeVar("T")


@dataclass(frozen=True)
class Rejection:
    """An answer that could not be read, twice."""

    template: str
    sample: int
    answer: str
    reason: str


@dataclass(frozen=True)
class Replies(Generic[T]):
    """What came of all samples of one question."""

    said: tuple[T, ...]
    rejected: tuple[Rejection, ...]


def ask_samples(
    model: LanguageModel, question: Question, read: Callable[[str], T], samples: int
) -> Replies[T]:
    """Ask `samples` times; an answer that `read` refuses (ValueError) is asked for once more."""
    said, rejected = [], []
    for sample in range(samples):
        try:
            said.append(read(model.ask(question, sample)))
        except ValueError:
            answer = model.ask(question, sample, again=True)
            try:
                said.append(read(answer))
            except ValueError as error:
                rejected.append(Rejection(question.template, sample, answer, str(error)))
    return Replies(tuple(said), tuple(rejected))


class Interview:
    """A model's answers about objects, in one wording.

    Args:
        model: who is asked.
        wording: ``paper``, ``question``, ``list`` or ``json``; see `hoi.priors.prompts`.
        map_by_model: whether words outside the alias table go to the second prompt.
    """

    def __init__(self, model: LanguageModel, wording: str = "paper", map_by_model: bool = False):
        self.model, self.wording, self.map_by_model = model, wording, map_by_model
        self._labels: dict[tuple[str, str], str] = {}

    def size(self, category: str) -> Replies[SizeSaid]:
        """What the model says of an object's size."""
        model, prompt = self.model, size_prompt(category, self.wording)
        template = f"size/{self.wording}"
        if self.wording == "json":
            question = model.json_question(prompt, size_schema(), template)
            return ask_samples(model, question, read_json_size, model.config.samples)
        question = model.question(prompt, ("\n",), template)
        return ask_samples(model, question, read_size, model.config.samples)

    def contacts(self, category: str, action: str) -> Replies[ContactsSaid]:
        """What the model says touches, in its own words."""
        model, template = self.model, f"contacts/{self.wording}"
        if self.wording == "json":
            parts = parts_of(category)
            prompt = json_contact_prompt(category, action, parts)
            question = model.json_question(prompt, contact_schema(parts), template)

            def read(answer: str) -> ContactsSaid:
                return read_json_contacts(answer, parts)

            return ask_samples(model, question, read, model.config.samples)
        prompt = contact_prompt(category, action, self.wording)
        # the paper's own example goes on in a second line, the others end with the line
        stop = ("\n\n", "Action:") if self.wording == "paper" else ("\n",)
        question = model.question(prompt, stop, template)
        return ask_samples(model, question, read_contacts, model.config.samples)

    def label(self, category: str, pair: NamedPair) -> LabelledPair:
        """The labels of a pair; empty where nothing fits."""
        part = map_object_part(category, pair.object_part).label
        if part is None:
            part = self._by_model(category, pair.object_part, parts_of(category))
        body = map_body_part(pair.body_part)
        region, side = body.region, pair.side or body.side
        if not region:
            region = self._by_model("", pair.body_part, BODY_VOCABULARY)
        return LabelledPair(part, region, side if region else "")

    def _by_model(self, category: str, words: str, labels: Sequence[str]) -> str:
        """The second prompt; an unreadable answer is no label."""
        if not self.map_by_model:
            return ""
        key = category, words
        if key not in self._labels:
            prompt = (
                object_part_prompt(category, words, labels) if category else body_part_prompt(words)
            )
            kind = "object_part" if category else "body_part"
            question = self.model.question(prompt, ("\n",), f"map/{kind}")
            question = question.model_copy(update={"temperature": 0.0})
            replies = ask_samples(self.model, question, lambda text: read_label(text, labels), 1)
            self._labels[key] = replies.said[0] if replies.said else ""
        return self._labels[key]


def parts_of(category: str) -> tuple[str, ...]:
    """Part labels that an answer about this object may name; KeyError for an unknown object."""
    return OBJECT_PARTS[category]


def ask_size(model: LanguageModel, category: str) -> float:
    """Metres: the median answer to the paper's prompt. ValueError when none can be read."""
    replies = Interview(model).size(category)
    if not replies.said:
        raise ValueError(_why("size", category, replies.rejected))
    return middle([said.length for said in replies.said])


def ask_contacts(model: LanguageModel, category: str, action: str) -> dict[tuple[str, str], float]:
    """Pair of parts in the model's words -> share of the answers to the paper's prompt.

    Most frequent first. Raises ValueError when no answer can be read.
    """
    replies = Interview(model).contacts(category, action)
    if not replies.said:
        raise ValueError(_why("contacts", f"{action} {category}", replies.rejected))
    named = [{(p.object_part, p.body_part): None for p in said.pairs} for said in replies.said]
    return shares(named)


def middle(values: Sequence[float]) -> float:
    """The median; of an even number the upper middle one, so that it is one of the answers."""
    return sorted(values)[len(values) // 2]


def _why(what: str, of: str, rejected: Sequence[Rejection]) -> str:
    return f"no readable answer about {what} of {of!r}: {rejected[0].reason}"
