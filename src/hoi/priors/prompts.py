"""The paper's two prompts and what their answers mean [supplement, prompt templates]."""

from __future__ import annotations

import math
import re
from collections import Counter
from pathlib import Path

from hoi.priors.client import LanguageModel

PROMPTS: Path = Path(__file__).parents[1] / "data" / "priors" / "prompts"

_METRES = {
    "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0,
    "cm": 0.01, "mm": 0.001, "in": 0.0254, "inch": 0.0254, "inches": 0.0254,
    "ft": 0.3048, "foot": 0.3048, "feet": 0.3048,
}  # fmt: skip
_LENGTH = re.compile(r"(\d+(?:\.\d+)?)(?:\s*(?:-|–|to)\s*(\d+(?:\.\d+)?))?\s*([a-zA-Z]+)?")
_NOTHING = ("none", "no contact", "nothing")


def size_prompt(category: str) -> str:
    """The cloze that asks for an object's length."""
    return _template("size").replace("OBJECT", category)


def contact_prompt(category: str, action: str) -> str:
    """The cloze that asks which parts touch."""
    head, _, tail = _template("contacts").rpartition("Action: ACTION")
    tail = tail.replace("OBJECT", category)
    return f"{head}Action: {action}{tail}"


def parse_length(answer: str, shortest_m: float = 0.01, longest_m: float = 5.0) -> float:
    """Metres from an answer such as "0.85m", "85 cm" or "0.8 - 1.0 m" (its middle).

    Raises ValueError when there is no length or it is implausible.
    """
    match = _LENGTH.search(answer)
    if match is None:
        raise ValueError(f"no length in {answer!r}")
    low, high, unit = match.groups()
    unit = (unit or "m").lower()
    if unit not in _METRES:
        raise ValueError(f"unknown unit {unit!r} in {answer!r}")
    value = (float(low) + float(high or low)) / 2 * _METRES[unit]
    if not (math.isfinite(value) and shortest_m <= value <= longest_m):
        raise ValueError(f"{value:g} m is no plausible size (from {answer!r})")
    return value


def parse_contacts(answer: str) -> list[tuple[str, str]]:
    """Pairs of object part and body part from "seat/butt, back/back"; "none" is no pair.

    Raises ValueError for anything else.
    """
    pairs: list[tuple[str, str]] = []
    for item in re.split(r"[,;\n]", answer.split("Action:")[0]):
        item = item.strip(" .()")
        if not item or item.lower() in _NOTHING:
            continue
        parts = [part.strip().lower() for part in item.split("/")]
        if len(parts) != 2 or not all(parts):
            raise ValueError(f"{item!r} is not object part/body part")
        pairs.append((parts[0], parts[1]))
    return list(dict.fromkeys(pairs))


def ask_size(model: LanguageModel, category: str) -> float:
    """Metres: the median of the model's answers. Raises ValueError for an answer without one."""
    answers = _ask(model, size_prompt(category), stop=("\n",), template="size")
    lengths = sorted(parse_length(answer) for answer in answers)
    return lengths[len(lengths) // 2]


def ask_contacts(model: LanguageModel, category: str, action: str) -> dict[tuple[str, str], float]:
    """Pair of parts -> share of the model's answers that name it, most frequent first."""
    answers = _ask(
        model, contact_prompt(category, action), stop=("\n\n", "Action:"), template="contacts"
    )
    counts = Counter(pair for answer in answers for pair in parse_contacts(answer))
    return {pair: count / len(answers) for pair, count in counts.most_common()}


def _ask(model: LanguageModel, prompt: str, stop: tuple[str, ...], template: str) -> list[str]:
    return [
        model.ask(model.question(prompt, stop, template, sample))
        for sample in range(model.config.samples)
    ]


def _template(name: str) -> str:
    """A prompt as the paper prints it, without the line break that ends the file."""
    return (PROMPTS / f"{name}.txt").read_text(encoding="utf-8").rstrip("\n")
