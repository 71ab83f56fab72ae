"""The base of every configuration model: unknown keys are errors, values are frozen."""

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Configuration of one part of the pipeline."""

    model_config = ConfigDict(extra="forbid", frozen=True)
