"""Where the files of other systems are; importable without any heavy library.

Paths may hold fields that name the frame: ``{stem}`` (photo file without suffix), ``{file}``,
``{frame_id}``, and in BEHAVE's layout ``{sequence}`` and ``{time}``. A relative path starts in the
folder of the data set.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator, model_validator

from hoi.readers.paths import FrameNames, check_template, fill
from hoi.settings import Settings

DataSet = Literal["behave", "behave_mini", "photos"]


class _Files(Settings):
    path: str = Field(min_length=1, description="file or template")

    @field_validator("path")
    @classmethod
    def _known_fields(cls, path: str) -> str:
        return check_template(path)


class MaskFiles(Settings):
    """Masks: one picture each of person and object, or the instances of a segmenter."""

    format: Literal["png", "coco_json"]
    person: str = Field(default="", description="png: grey picture, above 127 is the person")
    object: str = Field(default="", description="png: the same of the object")
    path: str = Field(default="", description="coco_json: results list or annotation file")
    annotations: str = Field(
        default="",
        description="coco_json: annotation file whose images and categories the ids of a results "
        "list refer to; by default image ids are file names or numbers, categories COCO's",
    )

    @model_validator(mode="after")
    def _complete(self) -> MaskFiles:
        wanted = ("person", "object") if self.format == "png" else ("path",)
        for key in ("person", "object", "path", "annotations"):
            check_template(getattr(self, key))
        absent = [key for key in wanted if not getattr(self, key)]
        if absent:
            raise ValueError(f"format {self.format} needs {' and '.join(absent)}")
        return self


class KeypointFiles(_Files):
    """2D keypoints of one or several people."""

    format: Literal["openpose", "coco_json", "mmpose"]
    annotations: str = Field(default="", description="coco_json: as for masks")


class BodyFiles(_Files):
    """SMPL poses of one or several people, with which the body fit starts."""

    format: Literal["pare", "four_d_humans", "frankmocap", "smpl"]


class ContactFiles(_Files):
    """Contact probability of every body vertex, in place of the language model's contacts."""

    format: Literal["npz"] = "npz"


class OtherSystems(Settings):
    """What other systems found in the frames of one data set."""

    masks: MaskFiles | None = None
    keypoints: KeypointFiles | None = None
    bodies: BodyFiles | None = None
    contacts: ContactFiles | None = None

    def files(self, names: FrameNames, root: Path | str) -> list[Path]:
        """The existing files that are read for one frame, sorted."""
        templates: list[str] = []
        if self.masks is not None:
            templates += [self.masks.person, self.masks.object]
            templates += [self.masks.path, self.masks.annotations]
        if self.keypoints is not None:
            templates += [self.keypoints.path, self.keypoints.annotations]
        templates += [part.path for part in (self.bodies, self.contacts) if part is not None]
        paths = {fill(template, names, root) for template in templates if template}
        return sorted(path for path in paths if path.is_file())
