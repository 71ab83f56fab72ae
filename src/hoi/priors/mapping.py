"""From the words of an answer to the labels of meshes [paper 3.3, the second prompt].

Object parts map to the part names of PartNet, body parts to the regions of the body model. An
alias decides first, then the label itself; a word that fits neither is reported as unmapped, so
that a missing part shows in the artifact and not only as a weaker loss.
"""

from __future__ import annotations

import re
from typing import NamedTuple

_CHAIR = ("chair_seat", "chair_back", "chair_arm", "chair_base")
_TABLE = ("tabletop", "table_base")
_BAG = ("bag_body", "handle", "shoulder_strap")
_MUG = ("body", "handle")

OBJECT_PARTS: dict[str, tuple[str, ...]] = {
    "chair": _CHAIR,
    "couch": _CHAIR,
    "stool": ("chair_seat", "chair_base"),
    "table": _TABLE,
    "desk": _TABLE,
    "keyboard": ("frame", "key"),
    "backpack": _BAG,
    "bag": _BAG,
    "handbag": _BAG,
    "suitcase": ("bag_body", "handle"),
    "scissors": ("blade", "handle", "blade_handle_set"),
    "bowl": ("container",),
    "cup": _MUG,
    "mug": _MUG,
    "bottle": ("body", "lid", "handle"),
    "laptop": ("screen_side", "base_side"),
    "trashcan": ("container", "cover"),
    "skateboard": ("deck", "truck", "wheel"),
    "surfboard": ("board", "fin"),
    "skis": ("ski", "binding"),
    "ball": ("surface",),
    "bicycle": ("wheel", "frame", "seat", "handlebar", "pedal"),
    "teddy": ("body", "head", "ear", "arm", "leg"),
}
"""Category -> part labels that its contacts may name (PartNet's names)."""

_CHAIR_ALIASES = {
    "seat": "chair_seat", "cushion": "chair_seat", "seat cushion": "chair_seat",
    "back": "chair_back", "backrest": "chair_back", "back rest": "chair_back",
    "top rail": "chair_back", "arm": "chair_arm", "armrest": "chair_arm", "arm rest": "chair_arm",
    "leg": "chair_base", "chair leg": "chair_base", "base": "chair_base", "frame": "chair_base",
    "footrest": "chair_base",
}  # fmt: skip
_TABLE_ALIASES = {
    "top": "tabletop", "table top": "tabletop", "desktop": "tabletop", "surface": "tabletop",
    "edge": "tabletop", "table edge": "tabletop", "leg": "table_base", "table leg": "table_base",
    "base": "table_base", "frame": "table_base",
}  # fmt: skip
_BAG_ALIASES = {
    "body": "bag_body", "bag": "bag_body", "backpack": "bag_body", "suitcase": "bag_body",
    "compartment": "bag_body", "front": "bag_body", "side": "bag_body", "lid": "bag_body",
    "back": "bag_body", "back panel": "bag_body",
    # zippers are split off before PartNet merges its labels, and part of the body after
    "zipper": "bag_body", "strap": "shoulder_strap", "grip": "handle",
    "pull out handle": "handle", "carrying handle": "handle", "top handle": "handle",
}  # fmt: skip
_MUG_ALIASES = {"cup": "body", "mug": "body", "rim": "body", "side": "body"}

_OBJECT_ALIASES: dict[str, dict[str, str]] = {
    "chair": _CHAIR_ALIASES,
    "couch": _CHAIR_ALIASES,
    "stool": _CHAIR_ALIASES,
    "table": _TABLE_ALIASES,
    "desk": _TABLE_ALIASES,
    "keyboard": {"space bar": "key", "button": "key", "case": "frame", "edge": "frame",
                 "body": "frame", "side": "frame", "keyboard": "frame", "enter key": "key"},
    "backpack": _BAG_ALIASES,
    "bag": _BAG_ALIASES,
    "handbag": _BAG_ALIASES,
    "suitcase": _BAG_ALIASES,
    "scissors": {"blade handle": "blade_handle_set", "finger hole": "handle", "grip": "handle"},
    "bowl": {"bowl": "container", "rim": "container", "side": "container",
             "inside": "container"},
    "cup": _MUG_ALIASES,
    "mug": _MUG_ALIASES,
    "bottle": {"bottle": "body", "neck": "body", "cap": "lid", "opening": "lid", "mouth": "lid"},
    "laptop": {"keyboard": "base_side", "key": "base_side", "base": "base_side",
               "touchpad": "base_side", "palm rest": "base_side", "body": "base_side",
               "laptop": "base_side", "screen": "screen_side", "lid": "screen_side"},
    "trashcan": {"body": "container", "rim": "container", "lid": "cover",
                 "trashcan": "container"},
    "skateboard": {"board": "deck", "grip tape": "deck"},
    "surfboard": {"deck": "board", "surfboard": "board"},
    "skis": {"boot": "binding", "ski boot": "binding"},
    "ball": {"ball": "surface", "soccer": "surface", "football": "surface"},
    # the paper's own prompt spells pedal so
    "bicycle": {"paddle": "pedal", "saddle": "seat", "handle bar": "handlebar"},
    "teddy": {"paw": "arm", "belly": "body", "back": "body", "foot": "leg",
              "chest": "body", "teddy": "body"},
}  # fmt: skip

PAIRED = ("hand", "foot", "leg", "arm", "forearm", "thigh")
"""Regions that come as a left and a right one."""

_SINGLE = (
    "head", "neck", "torso", "back", "butt", "chest", "belly", "waist", "shoulders", "lap",
    "mouth", "body",
)  # fmt: skip
BODY_VOCABULARY: tuple[str, ...] = (*_SINGLE, *PAIRED)
"""Body parts as a model may name them, without sides."""

BODY_REGIONS: tuple[str, ...] = (
    *_SINGLE,
    *(f"{side}_{limb}" for limb in PAIRED for side in ("left", "right")),
)
"""Regions of the body model that a contact may name; limbs come in pairs."""

_BODY_ALIASES = {
    "bottom": "butt", "buttock": "butt", "backside": "butt", "behind": "butt", "seat": "butt",
    "glute": "butt", "rear": "butt", "feet": "foot", "sole": "foot", "toe": "foot",
    "finger": "hand", "fingertip": "hand", "palm": "hand", "thumb": "hand", "fist": "hand",
    "shoulder": "shoulders", "hip": "waist", "stomach": "belly", "abdomen": "belly",
    "spine": "back", "upper back": "back", "lower back": "back", "throat": "neck",
    "nape": "neck", "lip": "mouth", "face": "head", "upper leg": "thigh", "hamstring": "thigh",
    "lower arm": "forearm", "whole body": "body", "trunk": "torso",
}  # fmt: skip


class ObjectPart(NamedTuple):
    """What an object part's name maps to; `label` is None when it maps to nothing."""

    label: str | None
    how: str  # alias | exact | unmapped


class BodyPart(NamedTuple):
    """What a body part's name maps to: regions of the body model, none when unmapped.

    `region` and `side` say the same without pairs: "hands" is hand with no side.
    """

    regions: tuple[str, ...]
    how: str  # alias | exact | unmapped
    region: str = ""
    side: str = ""


def map_object_part(category: str, text: str) -> ObjectPart:
    """Label of an object part named in free text, e.g. ("chair", "seat") -> chair_seat.

    Raises KeyError when the category has no vocabulary.
    """
    labels, aliases = OBJECT_PARTS[category], _OBJECT_ALIASES[category]
    for name in _spellings(text):
        if aliases.get(name) in labels:
            return ObjectPart(aliases[name], "alias")
        if name.replace(" ", "_") in labels:
            return ObjectPart(name.replace(" ", "_"), "exact")
    return ObjectPart(None, "unmapped")


def map_body_part(text: str) -> BodyPart:
    """Regions of a body part named in free text, e.g. "hands" -> left_hand and right_hand.

    A limb without a side is both limbs; "left hand" is one.
    """
    for name in _spellings(text):
        side, _, limb = name.rpartition(" ")
        if side not in ("left", "right", "both"):
            side, limb = "", name
        how = "alias" if limb in _BODY_ALIASES else "exact"
        region = _BODY_ALIASES.get(limb, limb)
        regions = expand_region(region, side)
        if regions:
            return BodyPart(regions, how, region, side if region in PAIRED else "")
    return BodyPart((), "unmapped")


def expand_region(region: str, side: str) -> tuple[str, ...]:
    """Body regions of a limb and a side (left, right, both, either or empty); none if unknown."""
    if region in PAIRED:
        sides = (side,) if side in ("left", "right") else ("left", "right")
        return tuple(f"{each}_{region}" for each in sides)
    return (region,) if region in BODY_REGIONS else ()


def _spellings(text: str) -> list[str]:
    """The name as written (lower case, no article), and in the singular."""
    name = " ".join(re.sub(r"[^a-z]+", " ", text.lower()).split())
    name = name.removeprefix("the ")
    return [name, name[:-1]] if name.endswith("s") and not name.endswith("ss") else [name]
