"""Templates of paths, and the names of a frame that fill them. Standard library only."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

FIELDS = ("stem", "file", "frame_id", "sequence", "time")
_FIELD = re.compile(r"\{([^{}]*)\}")


@dataclass(frozen=True)
class FrameNames:
    """How files may call a frame: `file` is the picture's file name, `stem` without suffix."""

    frame_id: str
    file: str
    sequence: str = ""
    time: str = ""

    @property
    def stem(self) -> str:
        return Path(self.file).stem

    def fields(self) -> Mapping[str, str]:
        return {name: getattr(self, name) for name in FIELDS}


def behave_names(frame_id: str, sequence: str, time: str, kinect: int = 1) -> FrameNames:
    """How files may call a frame of BEHAVE's layout."""
    return FrameNames(frame_id, f"k{kinect}.color.jpg", sequence, time)


def check_template(template: str) -> str:
    """The template itself; raises ValueError for a field that no frame has."""
    unknown = [name for name in _FIELD.findall(template) if name not in FIELDS]
    if unknown:
        known = ", ".join("{" + name + "}" for name in FIELDS)
        raise ValueError(f"no frame has a {{{unknown[0]}}}; known fields: {known}")
    return template


def is_per_frame(template: str) -> bool:
    """Whether every frame has a file of its own."""
    return bool(_FIELD.search(template))


def fill(template: str, names: FrameNames, root: Path | str) -> Path:
    """The file of one frame; relative templates start in `root`."""
    fields = names.fields()
    filled = _FIELD.sub(lambda match: fields[match[1]], template)
    path = Path(filled).expanduser()
    return path if path.is_absolute() else Path(root).expanduser() / path
