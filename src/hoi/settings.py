"""The base of every configuration model: unknown keys are errors, values are frozen."""

from typing import Literal

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Configuration of one part of the pipeline."""

    model_config = ConfigDict(extra="forbid", frozen=True)


#: The camera a method believes in: the photo's own, or PHOSA's guess for every photo.
CameraModel = Literal["photo", "longest_side"]
