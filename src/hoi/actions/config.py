"""Every setting of the action stage, and of the pose database it looks into."""

from typing import Literal

from pydantic import Field

from hoi.settings import Settings

COMPARED_JOINTS = (
    "left_hip", "right_hip", "left_knee", "right_knee", "spine1", "spine2", "spine3",
    "left_collar", "right_collar", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
)  # fmt: skip
"""Joints whose rotations are compared: what a keypoint fit observes and an action needs.

Left out: the pelvis (which way the person faces), head and neck (where the person looks), and
ankles, feet, wrists and hands (hardly observed).
"""


class ActionsConfig(Settings):
    """How a pose becomes an action [paper 3.2]."""

    metric: Literal["rotation_matrix", "axis_angle"] = Field(
        default="rotation_matrix",
        description="what the Euclidean distance is taken over. axis_angle: the model's own "
        "rotation vectors, as in the paper; rotation_matrix: nine numbers a joint, without their "
        "2 pi wrap",
    )
    joints: tuple[str, ...] = Field(default=COMPARED_JOINTS, description="joints that are compared")
    tilt_weight: float = Field(
        default=2.0,
        ge=0,
        description="weight of the pelvis's tilt against gravity, taking the image's up for up. "
        "The paper compares joints only (0), which cannot tell a squat from a seat; at 1.4 a tilt "
        "counts like the rotation of one joint",
    )
    min_conceptnet_weight: float = Field(
        default=1.0, description="ConceptNet edges below this weight are no actions [3.2: 1]"
    )
    temperature: float = Field(
        default=0.35,
        gt=0,
        description="an action's probability is proportional to exp(-d / temperature), d the "
        "distance of its nearest pose",
    )
    unknown_beyond: float = Field(
        default=3.5,
        gt=0,
        description="farther than this from every pose, the action is unknown: the retrieved one "
        "is kept and the artifact says so",
    )
    runners_up: int = Field(
        default=10, ge=0, description="most nearest poses of other actions recorded"
    )


class DatabaseConfig(Settings):
    """How the authored base poses are multiplied into the database."""

    variants: int = Field(default=16, ge=1, description="draws from the ranges of each base pose")
    jitter_degrees: float = Field(
        default=3.0, ge=0, description="sd of the noise on each compared joint"
    )
    seed: int = Field(default=0, ge=0, description="seed of the draws")
