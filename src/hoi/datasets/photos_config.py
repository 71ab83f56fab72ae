"""Settings of a folder of photos."""

from pydantic import Field

from hoi.settings import Settings

#: The category of a photo whose object nobody named.
AUTO = "auto"


class PhotosConfig(Settings):
    """Where photos are, what is in them, and what is assumed of a camera that does not say."""

    folder: str = Field(default="examples/photos", description="jpg, png and webp files are read")
    objects: dict[str, str] = Field(
        default={},
        description="photo (file name without suffix) -> object category; goes before the files "
        "<photo>.yaml and objects.yaml in the folder",
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
