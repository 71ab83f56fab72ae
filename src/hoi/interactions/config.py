"""Every number of the interaction database."""

from pydantic import Field

from hoi.settings import Settings


class InteractionsConfig(Settings):
    """Where the images are and which of them count [3.2, building the interaction database]."""

    folder: str = Field(
        default="",
        description="<folder>/<query>/*.jpg with queries such as 'woman sit chair', or "
        "<folder>/manifest.csv with the columns image and query; empty: there is none",
    )
    min_side_px: int = Field(
        default=300, ge=1, description="both sides must have more pixels [3.2: 300]"
    )
    person_score: float = Field(
        default=0.4, ge=0, le=1, description="a second person this sure drops the image"
    )
    object_score: float = Field(
        default=0.4, ge=0, le=1, description="a second object of the class this sure drops it"
    )
    min_box_iou: float = Field(
        default=0.02,
        ge=0,
        le=1,
        description="IoU of the boxes of person and object under which there is no interaction; "
        "the paper uses their IoU and prints no number",
    )
    max_keypoint_error: float = Field(
        default=0.05,
        gt=0,
        description="median distance of the fitted body from its keypoints, as a share of the "
        "longer side of the person's box, above which the pose is not believed (not in the paper)",
    )
    mirrored: bool = Field(default=True, description="every pose also left-right mirrored")
    with_package: bool = Field(
        default=True, description="the poses of the package are kept beside those of the images"
    )
    default_field_of_view_deg: float = Field(
        default=55.0, gt=5, lt=150, description="of the longer side, for images without EXIF"
    )
    chunk_size: int = Field(default=16, ge=1, description="images that one job works through")
