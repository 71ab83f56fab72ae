"""The prompts, and what an answer to them means [paper 3.3 and supplement, prompt templates].

``paper`` is the paper's cloze text, verbatim. ``question`` and ``list`` ask the same in other words
(does the answer depend on the wording?). ``json`` is for chat models: it restricts the answer to
the labels that meshes and body have, and asks for more than the paper does.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hoi.priors.mapping import BODY_VOCABULARY, PAIRED
from hoi.priors.tables import FACINGS, RELATIONS

PROMPTS: Path = Path(__file__).parents[1] / "data" / "priors" / "prompts"
CLOZES = ("paper", "question", "list")

AXES = ("height", "width", "depth")

_METRES = {
    "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0,
    "cm": 0.01, "mm": 0.001, "in": 0.0254, "inch": 0.0254, "inches": 0.0254,
    "ft": 0.3048, "foot": 0.3048, "feet": 0.3048,
}  # fmt: skip
_LENGTH = re.compile(r"(\d+(?:\.\d+)?)(?:\s*(?:-|–|to)\s*(\d+(?:\.\d+)?))?\s*([a-zA-Z]+)?")
_NOTHING = ("none", "no contact", "nothing")
_LONGEST_NAME = 40
_SHORTEST_M, _LONGEST_M = 0.01, 5.0
_THINNEST_M = 0.001  # a side may be that of a pair of scissors that lies flat


@dataclass(frozen=True)
class NamedPair:
    """Object part and body part in the words of an answer; `side` only where it is said apart."""

    object_part: str
    body_part: str
    side: str = ""


@dataclass(frozen=True)
class ContactsSaid:
    """One answer about contact; no pair means that nothing touches."""

    pairs: tuple[NamedPair, ...]
    relation: str = ""
    facing: str = ""


@dataclass(frozen=True)
class SizeSaid:
    """One answer about size, metres; `extents`: axis -> (low, typical, high) where asked for."""

    length: float
    extents: tuple[tuple[str, tuple[float, float, float]], ...] = ()


# ------------------------------------------------------------------------------ the prompts


def size_prompt(category: str, wording: str = "paper") -> str:
    """The text that asks for an object's length."""
    return _template("size", wording).replace("OBJECT", category)


def contact_prompt(category: str, action: str, wording: str = "paper") -> str:
    """The text that asks which parts touch."""
    text = _template("contacts", wording)
    if wording == "paper":  # its first lines speak of objects and actions, too
        head, _, tail = text.rpartition("Action: ACTION")
        return f"{head}Action: {action}{tail.replace('OBJECT', category)}"
    return text.replace("ACTION", action).replace("OBJECT", category)


def json_contact_prompt(category: str, action: str, parts: Sequence[str]) -> str:
    """The text that goes with `contact_schema`; it names the labels, too."""
    text = _template("contacts", "json").replace("ACTION", action)
    text = text.replace("OBJECT_PARTS", ", ".join(parts)).replace("OBJECT", category)
    return text.replace("BODY_PARTS", ", ".join(BODY_VOCABULARY))


def object_part_prompt(category: str, words: str, labels: Sequence[str]) -> str:
    """The second prompt of the paper, for object parts: which label is meant?"""
    text = _template("map", "object_part").replace("OBJECT", category)
    return text.replace("LABELS", ", ".join(labels)).replace("PART", words)


def body_part_prompt(words: str) -> str:
    """The second prompt of the paper, for body parts."""
    text = _template("map", "body_part").replace("LABELS", ", ".join(BODY_VOCABULARY))
    return text.replace("PART", words)


def contact_schema(parts: Sequence[str]) -> dict[str, Any]:
    """JSON schema of an answer about contact: labels as enums."""
    pair = _object(
        object_part={"enum": list(parts)},
        body_part={"enum": list(BODY_VOCABULARY)},
        side={"enum": ["left", "right", "either", "both", "none"]},
    )
    return _object(
        contacts={"type": "array", "items": pair},
        relation={"enum": list(RELATIONS)},
        facing={"enum": list(FACINGS)},
    )


def size_schema() -> dict[str, Any]:
    """JSON schema of an answer about size, metres."""
    number = {"type": "number"}
    extent = _object(low=number, typical=number, high=number)
    return _object(**{axis: extent for axis in AXES}, longest=number)


def _object(**properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _template(name: str, wording: str) -> str:
    """A prompt without the line break that ends its file; the paper's have no suffix."""
    stem = name if wording == "paper" else f"{name}_{wording}"
    return (PROMPTS / f"{stem}.txt").read_text(encoding="utf-8").rstrip("\n")


# ------------------------------------------------------------------------------ the answers


def parse_length(
    answer: str, shortest_m: float = _SHORTEST_M, longest_m: float = _LONGEST_M
) -> float:
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
    nothing = False
    for item in re.split(r"[,;\n]", answer.split("Action:")[0]):
        item = item.strip(" .()\t")
        if not item:
            continue
        if item.lower() in _NOTHING:
            nothing = True
            continue
        parts = [part.strip().lower() for part in item.split("/")]
        if len(parts) != 2 or not all(0 < len(part) <= _LONGEST_NAME for part in parts):
            raise ValueError(f"{item!r} is not object part/body part")
        pairs.append((parts[0], parts[1]))
    if not pairs and not nothing:
        raise ValueError(f"no contact in {answer!r}, and no word that there is none")
    return list(dict.fromkeys(pairs))


def read_size(answer: str) -> SizeSaid:
    """An answer to a cloze about size. Raises ValueError."""
    return SizeSaid(parse_length(answer))


def read_contacts(answer: str) -> ContactsSaid:
    """An answer to a cloze about contact. Raises ValueError."""
    return ContactsSaid(tuple(NamedPair(*pair) for pair in parse_contacts(answer)))


def read_json_size(answer: str) -> SizeSaid:
    """An answer to the JSON prompt about size. Raises ValueError for another form or numbers."""
    values = _json_object(answer, {*AXES, "longest"})
    longest = _metres(values["longest"], "longest", _SHORTEST_M)
    extents = []
    for axis in AXES:
        if not isinstance(values[axis], dict) or set(values[axis]) != {"low", "typical", "high"}:
            raise ValueError(f"{axis} is not a range with low, typical, high")
        low, typical, high = (
            _metres(values[axis][k], axis, _THINNEST_M) for k in ("low", "typical", "high")
        )
        if not low <= typical <= high:
            raise ValueError(f"{axis}: {low:g}, {typical:g}, {high:g} m are not in order")
        extents.append((axis, (low, typical, high)))
    return SizeSaid(longest, tuple(extents))


def read_json_contacts(answer: str, parts: Sequence[str]) -> ContactsSaid:
    """An answer to the JSON prompt about contact. Raises ValueError for another form or words."""
    values = _json_object(answer, {"contacts", "relation", "facing"})
    if not isinstance(values["contacts"], list):
        raise ValueError("contacts is not a list")
    pairs = []
    for each in values["contacts"]:
        if not isinstance(each, dict) or set(each) != {"object_part", "body_part", "side"}:
            raise ValueError(f"{each!r} is not a contact with object_part, body_part, side")
        body = _one_of(each["body_part"], BODY_VOCABULARY, "body_part")
        side = _one_of(each["side"], ("left", "right", "either", "both", "none"), "side")
        side = side if body in PAIRED and side != "none" else ""
        pairs.append(NamedPair(_one_of(each["object_part"], parts, "object_part"), body, side))
    return ContactsSaid(
        tuple(dict.fromkeys(pairs)),
        _one_of(values["relation"], RELATIONS, "relation"),
        _one_of(values["facing"], FACINGS, "facing"),
    )


def read_label(answer: str, labels: Sequence[str]) -> str:
    """An answer to the second prompt: one of `labels`, or empty for none. Raises ValueError."""
    word = answer.strip().split("\n")[0].strip(" .\"'").lower().replace(" ", "_")
    if word in _NOTHING:
        return ""
    return _one_of(word, labels, "label")


def _json_object(answer: str, keys: set[str]) -> dict[str, Any]:
    text = re.sub(r"^\s*```(?:json)?|```\s*$", "", answer.strip())
    try:
        values = json.loads(text)
    except ValueError as error:
        raise ValueError(f"not JSON ({error}): {answer[:80]!r}") from None
    if not isinstance(values, dict) or set(values) != keys:
        raise ValueError(f"expected the keys {', '.join(sorted(keys))}: {answer[:80]!r}")
    return values


def _metres(value: Any, name: str, shortest: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name}: {value!r} is not a number")
    if not shortest <= value <= _LONGEST_M:
        raise ValueError(f"{name}: {value:g} m is no plausible size")
    return float(value)


def _one_of(value: Any, words: Sequence[str], name: str) -> str:
    if value not in words:
        raise ValueError(f"{name}: {value!r} is none of {', '.join(words)}")
    return value
