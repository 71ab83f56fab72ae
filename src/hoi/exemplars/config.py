"""Every number of the exemplar library."""

from typing import Literal

from pydantic import Field

from hoi.settings import Settings

Source = Literal["procedural", "furniture", "folder"]
Remesh = Literal["watertight", "ball_pivoting"]


class ExemplarsConfig(Settings):
    """Which objects are candidates, and how representatives are chosen [paper 3.5, supp.]."""

    sources: tuple[Source, ...] = Field(
        default=("procedural", "furniture"),
        description="candidates: generated, the curated furniture of this package, own meshes; "
        "[] leaves those of `partnet` and `shapenet` alone",
    )
    k: int = Field(default=20, ge=1, description="clusters = exemplars of a category [3.5: 20]")
    grid: int = Field(
        default=30, ge=4, description="SDF cells along a side of the unit box [3.5: 30]"
    )
    vertices: int = Field(
        default=1000, ge=100, description="vertices of an exemplar mesh [3.5: 1000]"
    )
    procedural_pool: int = Field(default=32, ge=0, description="generated candidates of a category")
    kmeans_restarts: int = Field(default=10, ge=1, description="k-means++ starts; the best is kept")
    seed: int = Field(default=0, ge=0, description="seed of the generator and of k-means++")
    folder: str = Field(default="", description="own meshes: <folder>/<category>/*.obj, .glb, .ply")
    folder_up: Literal["y", "z"] = Field(default="y", description="up axis of the own meshes")
    folder_yaw_degrees: float = Field(
        default=0.0, description="turn about the up axis that brings their front to +z"
    )
    folder_unit_metres: float = Field(default=1.0, gt=0, description="their unit in metres")
    partnet: str = Field(
        default="",
        description="folder of PartNet v0 (data_v0) or of PartNet-Mobility (dataset), with one "
        "folder <id>/ a shape; its shapes become candidates",
    )
    partnet_yaw_degrees: Literal["auto"] | float = Field(
        default="auto",
        description="turn about y that brings their front to +z; auto: what the parts of most of "
        "the category's shapes say (the back of a chair), else 0",
    )
    shapenet: str = Field(
        default="",
        description="folder of ShapeNetCore v1 or v2, with <synset>/<model>/; "
        "its shapes become candidates, with parts by geometric rules",
    )
    shapenet_yaw_degrees: Literal["auto"] | float = Field(
        default="auto", description="the same; auto: v2 has its front at -z, v1 at +x"
    )
    remesh: Remesh = Field(
        default="watertight",
        description="how raw meshes become exemplars. watertight: a closed level set; "
        "ball_pivoting: points, ball pivoting, holes filled, non-manifold edges removed [3.5]. "
        "docs/partnet.md compares them",
    )
