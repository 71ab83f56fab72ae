"""Settings of everything that is drawn. None of them changes a number in a table."""

from typing import Annotated, Literal

from pydantic import Field

from hoi.settings import Settings

Colour = Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]


class ReportConfig(Settings):
    """Sizes, limits and colours of the report. Colours are sRGB hex codes, ``#rrggbb``."""

    image_width: int = Field(
        default=560, ge=64, description="width of a picture on a frame page, pixels"
    )
    tile_width: int = Field(default=220, ge=32, description="width of one exemplar picture, pixels")
    thumbnail_width: int = Field(
        default=240, ge=32, description="width of a card's picture, pixels"
    )
    jpeg_quality: int = Field(default=82, ge=1, le=95)
    supersampling: int = Field(
        default=2, ge=1, le=4, description="rays a pixel side, against jaggies"
    )

    max_frames: int = Field(default=24, ge=1, description="frame pages that go into the report")
    max_cards: int = Field(
        default=2000, ge=1, description="cards in the gallery; the rest is counted"
    )
    max_exemplars: int = Field(
        default=5, ge=1, description="exemplar pictures a method (Section 3.1: 5)"
    )
    max_candidates: int = Field(default=12, ge=1, description="detector boxes listed on a page")

    ablation: bool = Field(
        default=True, description="pages of the ablation's group show the ablation's methods, too"
    )
    poor_cm: float = Field(
        default=20.0, gt=0, description="object errors above are shown as failures, cm"
    )
    turned_share: float = Field(
        default=0.1,
        gt=0,
        description="distance between surfaces, of the diagonal, from which an object counts as "
        "turned or shaped wrongly",
    )
    groups: tuple[Literal["chair", "table", "keyboard", "backpack"], ...] = Field(
        default=("chair",), description="table groups that results/index.html shows"
    )

    crop_margin: float = Field(
        default=0.25, ge=0, description="margin about person and object, of its side"
    )
    overlay_opacity: float = Field(
        default=0.9, gt=0, le=1, description="of meshes drawn over the photo"
    )
    keypoint_confidence: float = Field(
        default=0.3, ge=0, le=1, description="weaker keypoints are hollow"
    )
    view_span_m: float = Field(
        default=2.4, gt=0, description="least width of side and top views, metres"
    )
    max_view_span_m: float = Field(
        default=12.0, gt=0, description="an object farther off is cut, metres"
    )
    view_grid_m: float = Field(
        default=0.5, gt=0, description="grid spacing of side and top views, metres"
    )

    contact_near_m: float = Field(
        default=0.02, gt=0, description="full contact colour up to here, metres"
    )
    contact_far_m: float = Field(
        default=0.10, gt=0, description="body's own colour from here on, metres"
    )
    ground_size_m: float = Field(default=3.0, gt=0, description="side of the ground square, metres")
    scene_precision_m: float = Field(
        default=1 / 4096,
        gt=0,
        description="vertex grid of scenes embedded in pages (exports are exact)",
    )

    body_colour: Colour = "#8fb0d6"
    object_colour: Colour = "#e0a050"
    contact_colour: Colour = "#c4262e"
    ground_colour: Colour = "#d9d7d2"
    person_line_colour: Colour = "#3f7fd0"
    object_line_colour: Colour = "#f08a1d"
    label_line_colour: Colour = "#ffffff"
    keypoint_colour: Colour = "#18b07a"
