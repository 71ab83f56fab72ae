"""Every number of the segmenter's recipe: scenes, training, evaluation."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, PositiveInt

from hoi.settings import Settings

Range = tuple[float, float]


class SceneConfig(Settings):
    """The rendered photos that the network learns from."""

    scenes: PositiveInt = Field(default=3000, description="pictures to learn from")
    validation: PositiveInt = Field(
        default=120, description="pictures of meshes and bodies that training never sees"
    )
    side: int = Field(default=512, ge=96, multiple_of=32, description="pixels; pictures are square")
    chunk: PositiveInt = Field(default=60, description="pictures that one job renders")
    held_out_share: float = Field(
        default=0.12, gt=0, lt=1, description="of the meshes, for validation only"
    )
    person_share: float = Field(default=0.92, ge=0, le=1, description="pictures with a person")
    scanned_share: float = Field(
        default=0.45, ge=0, le=1, description="people that are textured models, not our own body"
    )
    generated_share: float = Field(
        default=0.4, ge=0, le=1, description="main objects that are generated, where one can be"
    )
    outdoors_share: float = Field(
        default=0.25, ge=0, le=1, description="pictures where nobody rides or swings a thing"
    )
    alike_share: float = Field(
        default=0.65, ge=0, le=1, description="pictures whose things share a few tones"
    )
    hiding_share: float = Field(
        default=0.3, ge=0, le=1, description="pictures taken with the person before the object"
    )
    repainted_share: float = Field(
        default=0.55, ge=0, le=1, description="meshes with other materials than their own"
    )
    clutter: tuple[int, int] = Field(default=(4, 14), description="other objects, from and below")
    textures: PositiveInt = Field(default=70, description="procedural ones to draw from")
    jpeg_quality: int = Field(default=96, ge=30, le=100)


class TrainConfig(Settings):
    """Two phases of AdamW: the decoder alone, then the backbone from stride 8 on as well."""

    init: str | None = Field(
        default=None,
        description="checkpoint, or shipped weights (.onnx.gz), to go on from, instead of the "
        "detector's weights",
    )
    decoder_steps: int = Field(default=600, ge=0)
    whole_steps: int = Field(default=2600, ge=0)
    batch: PositiveInt = 24
    used_share: float = Field(
        default=0.35, ge=0, lt=1, description="crops of a person and what they use, without a box"
    )
    side: int = Field(default=192, ge=64, multiple_of=32, description="pixels of a crop at first")
    late_side: int = Field(default=320, ge=64, multiple_of=32, description="and in the second half")
    rate: float = Field(default=2e-3, gt=0, description="of learning, decoder")
    whole_rate: float = Field(default=1e-3, gt=0, description="of the decoder in the second phase")
    backbone_share: float = Field(default=0.1, ge=0, description="of that rate, for the backbone")
    warmup: PositiveInt = Field(default=60, description="steps")
    weight_decay: float = Field(default=1e-3, ge=0)
    averaging: float = Field(default=0.995, ge=0, lt=1, description="of the weights that ship")
    save_every: PositiveInt = Field(default=100, description="steps between checkpoints")
    device: Literal["auto", "cpu", "cuda"] = "auto"
    workers: int = Field(default=1, ge=0, description="threads that make crops")


class SegmenterRecipe(Settings):
    """How the shipped weights were made, and how others are."""

    seed: int = Field(default=4, ge=0)
    packs: str | None = Field(
        default=None,
        description="folder with the .sh3f packs of Debian's sweethome3d-furniture, where they are "
        "at hand; else the package is fetched with apt",
    )
    scenes: SceneConfig = SceneConfig()
    train: TrainConfig = TrainConfig()
    minimum_box_overlap: float = Field(
        default=0.4,
        gt=0,
        lt=1,
        description="IoU from which a detector's box counts as that of the object, in evaluation",
    )
