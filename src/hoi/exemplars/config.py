"""Every number of the exemplar library."""

from typing import Literal

from pydantic import Field

from hoi.settings import Settings

Source = Literal["procedural", "furniture", "folder"]


class ExemplarsConfig(Settings):
    """Which objects are candidates, and how representatives are chosen [paper 3.5, supp.]."""

    sources: tuple[Source, ...] = Field(
        ("procedural", "furniture"),
        description="candidates: generated, the curated furniture of this package, own meshes",
    )
    k: int = Field(20, ge=1, description="clusters = exemplars of a category [3.5: 20]")
    grid: int = Field(30, ge=4, description="SDF cells along each side of the unit box [3.5: 30]")
    vertices: int = Field(1000, ge=100, description="vertices of an exemplar mesh [3.5: 1000]")
    procedural_pool: int = Field(32, ge=0, description="generated candidates of a category")
    kmeans_restarts: int = Field(10, ge=1, description="k-means++ starts; the best is kept")
    seed: int = Field(0, ge=0, description="seed of the generator and of k-means++")
    folder: str = Field("", description="own meshes: <folder>/<category>/*.obj, .glb, .ply")
    folder_up: Literal["y", "z"] = Field("y", description="up axis of the own meshes")
    folder_yaw_degrees: float = Field(
        0.0, description="turn about the up axis that brings their front to +z"
    )
    folder_unit_metres: float = Field(1.0, gt=0, description="length of their unit, in metres")
