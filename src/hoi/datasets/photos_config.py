"""Settings of a folder of photos."""

from __future__ import annotations

from pydantic import Field, model_validator

from hoi.settings import Settings

#: The category of a photo whose object nobody named.
AUTO = "auto"


Box = tuple[float, float, float, float]
Point = tuple[float, float]


class PhotoNotes(Settings):
    """What a user says of one photo. Pixels are those of the photo as it is shown upright."""

    object: str | None = Field(default=None, description="category of the object")
    person: int | None = Field(
        default=None, ge=1, description="which of the people, counted from the left"
    )
    person_box: Box | None = Field(default=None, description="x0, y0, x1, y1 of the person")
    person_point: Point | None = Field(default=None, description="a pixel of the person")
    box: Box | None = Field(default=None, description="x0, y0, x1, y1 of the object")
    point: Point | None = Field(default=None, description="a pixel of the object")
    action: str | None = Field(
        default=None, description="what the person does, e.g. sit; goes before the retrieved action"
    )
    field_of_view_deg: float | None = Field(
        default=None, gt=0, lt=170, description="of the longer side"
    )
    focal_px: float | None = Field(default=None, gt=0, description="focal length in pixels")

    @model_validator(mode="after")
    def _boxes_have_an_area(self) -> PhotoNotes:
        for key in ("person_box", "box"):
            box = getattr(self, key)
            if box is not None and not (box[0] < box[2] and box[1] < box[3]):
                raise ValueError(f"{key}: expected x0, y0, x1, y1 with x0 < x1 and y0 < y1")
        return self


class PhotosConfig(Settings):
    """Where photos are, what is in them, and what is assumed of a camera that does not say."""

    folder: str = Field(
        default="examples/photos", description="jpg, png, webp and heic files are read"
    )
    objects: dict[str, str | PhotoNotes] = Field(
        default={},
        description="photo (file name without suffix) -> object category, or several notes on it; "
        "goes before the files <photo>.yaml and objects.yaml in the folder",
    )
    default_object: str = Field(
        default=AUTO, description="category of photos nobody named: auto lets the detector choose"
    )
    default_field_of_view_deg: float = Field(
        default=55.0,
        gt=5,
        lt=150,
        description="of the longer side, for photos without EXIF focal length",
    )
    max_side: int = Field(
        default=2048, ge=128, description="larger photos are scaled down to this, pixels"
    )
