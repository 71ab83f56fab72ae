"""Answers of language models as plain files that can be read, compared and committed.

One file a question, named by the hash of everything that can change its answer. What cannot is
not in it: no address, no key, no time. So replaying needs no network, and asking again gives the
same bytes where the answers are the same.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path, PurePath
from typing import Any, Literal

from pydantic import ValidationError

from hoi.errors import AssetError
from hoi.settings import Settings

RECORDINGS: Path = Path(__file__).parents[1] / "data" / "priors" / "recordings"
"""The recordings that come with the package."""


class Question(Settings):
    """Everything that can change an answer, except for the number of the sample."""

    api: Literal["completions", "chat"]
    model: str
    prompt: str
    system: str = ""
    temperature: float = 0.0
    max_tokens: int = 64
    stop: tuple[str, ...] = ()
    json_schema: str = ""  # canonical JSON text; empty: free text
    template: str = ""  # where the prompt comes from, for people

    def key(self) -> str:
        """sha256 that names the recording; the template's name does not count."""
        content = self.model_dump(mode="json", exclude={"template"})
        text = json.dumps(content, sort_keys=True, ensure_ascii=False, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


class Answer(Settings):
    """One sample: the text as it came, and what the server said of it."""

    answer: str
    finish_reason: str = ""
    served_model: str = ""
    origin: str = ""  # how an answer came here that no server gave, e.g. copied from a publication


class Recordings:
    """A folder of recorded answers: one subfolder a model, one JSON file a question.

    Samples are numbered; ``"3 again"`` is the second answer to sample 3, asked because the first
    could not be read.
    """

    def __init__(self, folder: Path | str):
        self.folder = Path(folder)

    def path(self, question: Question) -> Path:
        """Where the answers to a question are, or would be."""
        return self.folder / model_folder(question.model) / f"{question.key()}.json"

    def get(self, question: Question, sample: int = 0, again: bool = False) -> Answer | None:
        """A recorded answer, or None; raises AssetError when the file is damaged."""
        return self.answers(question).get(_entry(sample, again))

    def answers(self, question: Question) -> dict[str, Answer]:
        """All answers to a question by sample; raises AssetError when the file is damaged."""
        path = self.path(question)
        if not path.exists():
            return {}
        recorded, answers = read_recording(path)
        if recorded.key() != question.key():
            raise AssetError(f"{path}: answers another question than its name says; was it edited?")
        return answers

    def put(self, question: Question, answer: Answer, sample: int = 0, again: bool = False) -> None:
        """Record an answer beside those that are there; equal answers give equal bytes."""
        # some servers name the model by the path of its file
        answer = answer.model_copy(update={"served_model": PurePath(answer.served_model).name})
        answers = self.answers(question) | {_entry(sample, again): answer}
        record = {
            "question": question.model_dump(mode="json", exclude_defaults=True),
            "answers": {
                name: each.model_dump(mode="json", exclude_defaults=True)
                for name, each in sorted(answers.items(), key=_by_number)
            },
        }
        path = self.path(question)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}.partial")
        partial.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", "utf-8")
        partial.replace(path)

    def of_model(self, model: str) -> Iterator[tuple[Question, dict[str, Answer]]]:
        """Every question that a model was asked, with its answers, in the order of the files."""
        for path in sorted((self.folder / model_folder(model)).glob("*.json")):
            question, answers = read_recording(path)
            if question.model == model:
                yield question, answers


def read_recording(path: Path) -> tuple[Question, dict[str, Answer]]:
    """Question and answers of one file; raises AssetError naming the file when it is damaged."""
    try:
        record: Any = json.loads(path.read_text(encoding="utf-8"))
        answers = {str(name): Answer(**each) for name, each in record["answers"].items()}
        return Question(**record["question"]), answers
    except (ValueError, KeyError, TypeError, AttributeError, ValidationError) as error:
        raise AssetError(f"{path}: not a recorded answer: {error}") from error


def model_folder(model: str) -> str:
    """Folder name of a model: ``Qwen/Qwen3:8b`` -> ``qwen-qwen3-8b``."""
    return re.sub(r"[^a-z0-9.]+", "-", model.lower()).strip("-.") or "unnamed"


def _entry(sample: int, again: bool) -> str:
    return f"{sample} again" if again else str(sample)


def _by_number(item: tuple[str, Answer]) -> tuple[int, str]:
    number, _, again = item[0].partition(" ")
    return int(number), again
