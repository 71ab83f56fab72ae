"""Names in BEHAVE's tree: objects, action groups, sequences, frames and where their files lie.

Facts of the published layout (github.com/xiexh20/behave-dataset, README):

    sequences/DateXX_SubYY_<object>[_<action>]/info.json
    sequences/<sequence>/tSSSS.mmm/k1.color.jpg, k1.person_mask.*, k1.obj_rend_mask.*, k1.color.json
    sequences/<sequence>/tSSSS.mmm/person/fit02/person_fit.ply|pkl, <object>/fit01/<object>_fit.*
    calibs/intrinsics/<kinect>/calibration.json, calibs/DateXX/config/<kinect>/config.json
    objects/<object>/<object>.obj, <object>_fNNNN.ply, split.json

Standard library only: a workflow that merely plans pays no import of numpy.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

MIX = "mix"  # sequences without a suffix: several actions in one clip

#: the noun used for exemplars, priors and actions
CATEGORIES = {
    "chairblack": "chair",
    "chairwood": "chair",
    "stool": "stool",
    "tablesmall": "table",
    "tablesquare": "table",
    "backpack": "backpack",
    "suitcase": "suitcase",
    "keyboard": "keyboard",
}

#: all objects of the data set; those without an entry in `CATEGORIES` are in no result table
OBJECTS = (
    *CATEGORIES,
    *("basketball", "boxlarge", "boxlong", "boxmedium", "boxsmall", "boxtiny", "monitor"),
    *("plasticcontainer", "toolbox", "trashbin", "yogaball", "yogamat"),
)

_MEN = ("Sub01", "Sub02", "Sub03", "Sub04", "Sub05")
_WOMEN = ("Sub06", "Sub07", "Sub08")

#: rows of one result table
TABLE_GROUPS = {
    "chair": ("chairblack", "chairwood", "stool"),
    "table": ("tablesmall", "tablesquare"),
    "keyboard": ("keyboard",),
    "backpack": ("backpack", "suitcase"),
}

#: action groups that occur in BEHAVE, by object (suffix ``typing`` is the group ``type``)
ACTION_GROUPS = {
    "chairblack": ("hand", "lift", "liftreal", "sit", "sitstand", MIX),
    "chairwood": ("hand", "lift", "liftreal", "sit", "sitstand", MIX),
    "stool": ("hand", "lift", "liftreal", "sit", "sitstand", "move", MIX),
    "tablesmall": ("hand", "lift", "move", "sit", "lean", MIX),
    "tablesquare": ("hand", "lift", "move", "sit", "lean", MIX),
    "backpack": ("back", "hand", "hug", MIX),
    "suitcase": ("lift", "move", "ground", MIX),
    "keyboard": ("move", "type", MIX),
}

_SUFFIX_OF_GROUP = {"type": "typing"}
_GROUP_OF_SUFFIX = {"typing": "type"}
#: folder and file stems that stand for an object inside a frame, tried in this order
_FOLDER_NAMES = {
    "chairblack": ("chair", "chairblack"),
    "chairwood": ("chair", "chairwood"),
    "basketball": ("sports ball", "basketball"),
    "yogaball": ("sports ball", "yogaball"),
}
_SEQUENCE = re.compile(r"(Date\d+)_(Sub\d+)_([A-Za-z0-9]+)(?:_([A-Za-z0-9]+))?")
_TIME = re.compile(r"t\d+\.\d+")


@dataclass(frozen=True, order=True)
class FrameRef:
    """One frame of one sequence, by name. Raises ValueError on names that BEHAVE cannot have."""

    sequence: str  # Date03_Sub03_chairblack_sit
    time: str  # t0003.000
    object_name: str  # chairblack
    action: str  # sit; mix when the sequence has no suffix
    category: str  # chair

    def __post_init__(self) -> None:
        if not _SEQUENCE.fullmatch(self.sequence):
            raise ValueError(f"{self.sequence!r} is no BEHAVE sequence name")
        if not _TIME.fullmatch(self.time):
            raise ValueError(f"{self.time!r} is no BEHAVE frame folder (tSSSS.mmm)")
        if parse_sequence(self.sequence)[2:] != (self.object_name, self.action):
            raise ValueError(f"{self.sequence!r} is not of {self.object_name}, {self.action}")

    @property
    def frame_id(self) -> str:
        """One name for the frame, fit for file names: ``<sequence>-<time>``."""
        return f"{self.sequence}-{self.time}"


def parse_sequence(name: str) -> tuple[str, str, str, str]:
    """Date, subject, object and action group of a sequence name; raises ValueError."""
    match = _SEQUENCE.fullmatch(name)
    if match is None:
        raise ValueError(f"{name!r} is no BEHAVE sequence name (DateXX_SubYY_<object>[_<action>])")
    date, subject, object_name, suffix = match.groups()
    return date, subject, object_name, _GROUP_OF_SUFFIX.get(suffix, suffix or MIX)


def sequence_name(date: str, subject: str, object_name: str, action: str) -> str:
    """The inverse of :func:`parse_sequence`."""
    stem = f"{date}_{subject}_{object_name}"
    return stem if action == MIX else f"{stem}_{_SUFFIX_OF_GROUP.get(action, action)}"


def frame_ref(sequence: str, time: str) -> FrameRef:
    """The reference of one frame; raises ValueError when a name is none of BEHAVE's."""
    object_name, action = parse_sequence(sequence)[2:]
    category = CATEGORIES.get(object_name, object_name)
    return FrameRef(sequence, time, object_name, action, category)


def parse_frame_id(frame_id: str) -> FrameRef:
    """The inverse of :attr:`FrameRef.frame_id`."""
    sequence, _, time = frame_id.partition("-")
    return frame_ref(sequence, time)


def gender_of(subject: str) -> str:
    """The SMPL-H model of a subject where ``info.json`` does not say: male, female or neutral."""
    if subject in _MEN:
        return "male"
    return "female" if subject in _WOMEN else "neutral"


def is_frame_folder(name: str) -> bool:
    """Whether a folder name is that of a frame (tSSSS.mmm)."""
    return _TIME.fullmatch(name) is not None


def sequence_folder(root: Path | str, sequence: str) -> Path:
    """Folder of one sequence. The name is checked, so the path cannot leave `root`."""
    parse_sequence(sequence)
    return Path(root) / "sequences" / sequence


def frame_folder(root: Path | str, ref: FrameRef) -> Path:
    """Folder of one frame."""
    return sequence_folder(root, ref.sequence) / ref.time


def object_folder_names(object_name: str) -> tuple[str, ...]:
    """Stems under which an object's fit may be stored: both chairs as ``chair``, and so on."""
    return _FOLDER_NAMES.get(object_name, (object_name,))
