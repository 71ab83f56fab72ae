"""Every number of the object fit: where the search starts, how it narrows, what it keeps."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from hoi.settings import CameraModel, Settings

Range = tuple[float, float]


class RefineStep(Settings):
    """One round of the search: keep the best poses so far and improve them on one grid."""

    exemplars: PositiveInt | None = Field(
        default=None, description="exemplars that enter this step, best first; none: all"
    )
    poses: PositiveInt = Field(description="distinct poses of each exemplar that enter this step")
    resolution: PositiveInt = Field(description="pixels of the region's side")
    iterations: PositiveInt = Field(description="Adam steps")
    learning_rate: PositiveFloat = Field(
        description="of the 6D rotation and of the translation, in units of the object's size"
    )
    decay: bool = Field(default=True, description="lower the learning rate linearly towards zero")
    edge_weight: NonNegativeFloat = Field(
        description="rendered outline to mask outline, against 1 for the mask (PHOSA: 0.5)"
    )
    off_screen_weight: NonNegativeFloat = Field(
        default=0.0, description="vertices outside the region, in half sides of it (PHOSA: 1000)"
    )
    distinct_deg: NonNegativeFloat = Field(
        default=0.0, description="poses of one exemplar that enter differ by at least this angle"
    )


class Schedule(Settings):
    """From many starts to a few poses: score all, then refine in narrowing rounds."""

    score_resolution: PositiveInt = Field(
        default=64,
        description="pixels of the region's side when starts are scored, without gradient",
    )
    steps: tuple[RefineStep, ...] = Field(min_length=1)


#: Coarse to fine: many starts scored cheaply, exemplars pruned by their best scores.
FAST = Schedule(
    steps=(
        RefineStep(
            exemplars=12, poses=16, resolution=64, iterations=25, learning_rate=2e-2,
            edge_weight=1.0, distinct_deg=8.0,
        ),
        RefineStep(
            exemplars=8, poses=6, resolution=64, iterations=30, learning_rate=1.5e-2,
            edge_weight=1.0, distinct_deg=15.0,
        ),
        RefineStep(
            exemplars=8, poses=3, resolution=128, iterations=30, learning_rate=6e-3,
            edge_weight=0.3, distinct_deg=20.0,
        ),
    )
)  # fmt: skip

#: As printed in 3.5 (Adam 1e-3, 50 iterations) with the starts, grid and edge weight of PHOSA's
#: search, which the paper builds on: about half a minute per exemplar.
PAPER = Schedule(
    steps=(
        RefineStep(
            poses=2000, resolution=256, iterations=50, learning_rate=1e-3, decay=False,
            edge_weight=0.5,
        ),
    )
)  # fmt: skip

#: PHOSA's search for the time of a few seconds. Fifty steps of 1e-3 move a pose by .05 at most, so
#: that the best of 2000 ends among those that start well: only these are refined.
PHOSA = Schedule(
    steps=(
        RefineStep(
            poses=100, resolution=128, iterations=50, learning_rate=1e-3, decay=False,
            edge_weight=0.5,
        ),
    )
)  # fmt: skip

#: PHOSA's search as released, every start descended: half a minute per exemplar. The benchmark of
#: pose recovery compares with it.
PHOSA_RELEASED = Schedule(
    steps=tuple(step.model_copy(update={"off_screen_weight": 1000.0}) for step in PAPER.steps)
)


class ObjectFitConfig(Settings):
    """Configuration of the object fit.

    `init: so3` with `schedule: paper`, `num_starts: 2000` and `poses_per_exemplar: 1` is the search
    as printed; the defaults find better poses in a hundredth of the time.
    """

    camera: CameraModel = Field(
        default="photo",
        description="longest_side: PHOSA's guess of every camera. The joint stage must believe in "
        "the same",
    )
    shapes: Literal["library", "medoid"] = Field(
        default="library",
        description="medoid: only the exemplar that is most like all others, as PHOSA has one mesh "
        "a class",
    )
    init: Literal["upright", "so3"] = Field(
        default="upright",
        description="starts: upright objects before a level camera, or [3.1] uniform rotations. "
        "Poses may tilt freely afterwards in both",
    )
    num_starts: PositiveInt = Field(
        default=400, description="start poses per exemplar (PHOSA: 2000)"
    )
    yaw_deg: Range = Field(
        default=(0.0, 360.0), description="upright: turn about the object's up axis"
    )
    pitch_deg: Range = Field(
        default=(-3.0, 26.0), description="upright: how far the camera looks down"
    )
    roll_deg: Range = Field(default=(-8.0, 8.0), description="upright: roll of the camera")
    schedule: Literal["fast", "paper", "phosa", "phosa_released"] = "fast"
    fast: Schedule = FAST
    paper: Schedule = PAPER
    phosa: Schedule = PHOSA
    phosa_released: Schedule = PHOSA_RELEASED
    prune_by: PositiveInt = Field(
        default=4,
        description="an exemplar enters the first step by the mean of its so many best scores",
    )
    top_exemplars: PositiveInt = Field(default=5, description="[3.1] exemplars kept")
    poses_per_exemplar: PositiveInt = Field(default=2, description="poses kept of each; paper: 1")
    distinct_deg: NonNegativeFloat = Field(
        default=20.0, description="kept poses of one exemplar differ by at least this angle"
    )
    min_mask_pixels: PositiveInt = Field(
        default=64, description="a smaller visible mask fails the frame: empty_object_mask"
    )
    roi_margin: NonNegativeFloat = Field(
        default=0.3,
        description="the region reaches beyond the mask's box by this share of its side",
    )
    keep_threshold: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="cells covered by the person more than this are ignored",
    )
    occluded_growth: NonNegativeFloat = Field(
        default=0.35,
        description="starts grow beyond the box of the visible mask by up to this share when the "
        "person cuts the object, in proportion to how much of its outline is cut",
    )
    cut_gain: NonNegativeFloat = Field(
        default=3.0,
        description="growth is full when one in so many outline pixels touches the unknown",
    )

    second_mask: bool = Field(
        default=False,
        description="after the fit, cut a detected object out again with the best silhouette as "
        "prior, fit once more, and keep the fit with the smaller residual (docs/detection.md)",
    )

    @model_validator(mode="after")
    def _ranges_ascend(self):
        for name in ("yaw_deg", "pitch_deg", "roll_deg"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}: {low} is above {high}")
        return self

    @property
    def chosen_schedule(self) -> Schedule:
        """The schedule that `schedule` names."""
        return getattr(self, self.schedule)
