"""Every number of the evaluation."""

from typing import Literal

from pydantic import Field

from hoi.settings import Settings


class EvaluateConfig(Settings):
    """The protocol; its name goes into every table."""

    align: Literal["body", "none"] = Field(
        default="body",
        description="body: similarity Procrustes on the body, the same transform on the object "
        "(the paper, Section 4.2); none: as reconstructed",
    )
    samples: int = Field(
        default=10_000, ge=100, description="surface samples a mesh (CHORE's protocol)"
    )
    min_visible_fraction: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="frames whose object is seen less than this are left out",
    )
    failure_cm: float = Field(
        default=100.0, gt=0, description="an object further off counts as failed"
    )
