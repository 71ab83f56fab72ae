"""Every number of the evaluation."""

from typing import Literal

from pydantic import Field, PositiveFloat

from hoi.settings import Settings

#: How a reconstruction is brought to the truth, see `EvaluateConfig.align`.
Alignment = Literal["body", "joint", "surfaces", "none"]


class EvaluateConfig(Settings):
    """The protocol; its name goes into every table."""

    align: Alignment = Field(
        default="body",
        description="body: similarity Procrustes on the body, the same transform on the object "
        "(the paper, Section 4.2). joint: on body and object vertices stacked (CHORE and later "
        "papers); needs the true object's own mesh, else the body alone is aligned, and the "
        "protocol says so. surfaces: as joint for objects of any mesh, by closest points. none: "
        "as reconstructed",
    )
    also: tuple[Alignment, ...] = Field(
        default=("joint", "surfaces", "none"),
        description="further protocols, for results/behave_*.protocols.csv",
    )
    samples: int = Field(
        default=10_000, ge=100, description="surface samples a mesh (CHORE: 10,000; RHOBIN: 6,000)"
    )
    contact_cm: tuple[PositiveFloat, ...] = Field(
        default=(2.0, 5.0),
        description="a body vertex nearer to the object's surface than this touches it",
    )
    min_visible_fraction: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="frames whose object is seen less than this are left out (later papers: 0.3)",
    )
    failure_cm: float = Field(
        default=100.0, gt=0, description="an object further off counts as failed"
    )
