"""Which frames the generated data set has. Standard library only, so that planning is free."""

from __future__ import annotations

from hoi.datasets.behave_layout import (
    MIX,
    TABLE_GROUPS,
    FrameRef,
    frame_ref,
    sequence_name,
)
from hoi.datasets.behave_mini.config import BehaveMiniConfig
from hoi.errors import ConfigError

#: date, subjects of the single-action sequences, subject of the mixed ones (as in BEHAVE's test)
_SPLITS = {"test": ("Date03", ("Sub03", "Sub04"), "Sub05"), "tune": ("Date01", ("Sub01",), "Sub02")}

#: actions staged for each object; a mixed frame shows any of them
STAGED_ACTIONS = {
    "chairblack": ("hand", "lift", "liftreal", "sit", "sitstand"),
    "chairwood": ("hand", "lift", "liftreal", "sit", "sitstand"),
    "stool": ("hand", "lift", "liftreal", "sit", "sitstand"),
    "tablesmall": ("hand", "lift", "move", "sit"),
    "tablesquare": ("hand", "lift", "move", "sit"),
    "keyboard": ("move", "type"),
    "backpack": ("back", "hand", "hug"),
    "suitcase": ("lift", "move", "ground"),
}
_FIRST_SECOND = 3  # BEHAVE's sequences start here


def plan(config: BehaveMiniConfig, category_group: str, split: str) -> list[FrameRef]:
    """The frames of one table group and split, sorted: `frames_per_action` for every action.

    A larger `frames_per_action` keeps the frames of a smaller one. Frames of an action alternate
    between the objects of the group. Raises ConfigError on an unknown group or split.
    """
    refs = []
    for row, action in enumerate(group_actions(category_group)):
        names = _sequences(category_group, action, split)
        for k in range(config.frames_per_action):
            sequence = names[(row + k) % len(names)]
            refs.append(frame_ref(sequence, f"t{_FIRST_SECOND + k // len(names):04d}.000"))
    return sorted(refs)


def group_actions(category_group: str) -> tuple[str, ...]:
    """The action rows of one group, `mix` last."""
    if category_group not in TABLE_GROUPS:
        raise ConfigError(
            f"unknown category group {category_group!r}; known: {', '.join(TABLE_GROUPS)}"
        )
    rows = dict.fromkeys(a for o in TABLE_GROUPS[category_group] for a in STAGED_ACTIONS[o])
    return (*rows, MIX)


def split_table() -> dict[str, list[str]]:
    """The content of ``split.json``: every sequence of every group, by split."""
    return {
        split: sorted(
            name
            for group in TABLE_GROUPS
            for action in group_actions(group)
            for name in _sequences(group, action, split)
        )
        for split in _SPLITS
    }


def split_of(sequence: str) -> str:
    """The split of a sequence; raises ConfigError when the data set has no such sequence."""
    for split, names in split_table().items():
        if sequence in names:
            return split
    raise ConfigError(f"behave_mini has no sequence {sequence!r}")


def _sequences(category_group: str, action: str, split: str) -> list[str]:
    """Sequences of one action, so ordered that neighbours differ in object, then in subject."""
    if split not in _SPLITS:
        raise ConfigError(f"unknown split {split!r} of behave_mini; known: {', '.join(_SPLITS)}")
    date, subjects, mixer = _SPLITS[split]
    objects = TABLE_GROUPS[category_group]
    if action == MIX:
        return [sequence_name(date, mixer, name, MIX) for name in objects]
    able = [name for name in objects if action in STAGED_ACTIONS[name]]
    return [
        sequence_name(date, subjects[(turn + i) % len(subjects)], name, action)
        for turn in range(len(subjects))
        for i, name in enumerate(able)
    ]
