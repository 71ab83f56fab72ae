"""What stays constant while one frame's hypotheses are optimised, gathered once from artifacts."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from hoi.artifacts import Extents, Interaction
from hoi.errors import FrameFailure
from hoi.exemplars import Exemplar, sample_parts
from hoi.geometry import matrix_to_rotation_6d
from hoi.joint.config import JointConfig
from hoi.joint.contact_patches import given_patches, patch_pairs
from hoi.joint.contacts import ContactPair, paper_pairs, recipe_pairs, usable_contacts
from hoi.joint.correspondence import PairTable, pair_table
from hoi.joint.inputs import Inputs
from hoi.joint.phosa import PhosaScene, phosa_scene
from hoi.joint.signed_distance import SignedDistanceGrid, body_signed_distance
from hoi.rendering import MeshTopology, SilhouetteTarget, crop_mask, intrinsics_for


@dataclass(frozen=True)
class ObjectGeometry:
    """The exemplars of K hypotheses, padded to one batch, at library size (metres).

    Attributes:
        vertices: (K, V, 3); rows beyond an exemplar's own repeat its first vertex.
        groups: (topology, hypotheses, own vertices) for every exemplar in play.
        part_points, part_normals: (K, O, 3) area-uniform samples of all parts.
        part_present: (K, O) False where the exemplar lacks the part.
        part_slices: part name -> its rows in `part_points`.
        surface_points: (K, M, 3) area-uniform samples of the whole surface.
        extent: (K,) what the size prior measures. sizes: (K, 3) width, height, depth.
    """

    exemplars: list[Exemplar]
    vertices: Tensor
    groups: list[tuple[MeshTopology, Tensor, int]]
    part_points: Tensor
    part_normals: Tensor
    part_present: Tensor
    part_slices: dict[str, np.ndarray]
    surface_points: Tensor
    extent: Tensor
    sizes: Tensor


@dataclass(frozen=True)
class BodyGeometry:
    """The fitted body at scale 1, camera frame, metres: samples of its regions, soles, field.

    `points`, `normals` (B, 3); `slices`: region -> rows. `soles` (S, 3) vertices of both feet.
    """

    points: Tensor
    normals: Tensor
    slices: dict[str, np.ndarray]
    soles: Tensor
    field: SignedDistanceGrid | None


@dataclass(frozen=True)
class Problem:
    """Everything the loss terms of one frame look at, and where the optimisation starts.

    Attributes:
        start: (K, 11) rotation (6D), translation at library size (m), log scale, log human scale.
        size_range: least and greatest width, height, depth (3,) in metres; None: `size` alone.
        intrinsics: (3, 3) of the region of interest at the silhouette resolution.
        pixel_weight: what one pixel of that grid counts at the weights' resolution.
        stands_on_floor, feet_on_floor: who is known to stand on the floor, for the ground term.
        skipped: one sentence for each contact that could not be used.
    """

    start: Tensor
    object: ObjectGeometry
    body: BodyGeometry
    contacts: PairTable
    pairs: tuple[ContactPair, ...]
    only_opposing: bool
    opposing_first: bool
    size: float
    size_range: tuple[Tensor, Tensor] | None
    human_scale_free: bool
    intrinsics: Tensor
    target: SilhouetteTarget
    edge_weight: float
    pixel_weight: float
    stands_on_floor: bool
    feet_on_floor: bool
    up: Tensor
    penetration_points: int
    phosa: PhosaScene | None
    skipped: tuple[str, ...]

    @property
    def num_hypotheses(self) -> int:
        return len(self.start)


class BodyRegions:
    """Faces of every body region, from the model's vertex regions; built once per body model."""

    def __init__(self, faces: np.ndarray, part_vertices: dict[str, np.ndarray], num_vertices: int):
        self.faces = faces
        self.vertices = part_vertices
        self.part_faces: dict[str, np.ndarray] = {}
        for name, indices in part_vertices.items():
            inside = np.zeros(num_vertices, bool)
            inside[indices] = True
            whole = inside[faces].all(1)
            if whole.any():
                self.part_faces[name] = faces[whole]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.part_faces)

    def with_faces(self, faces_of: dict[str, np.ndarray]) -> BodyRegions:
        """These regions and others, given by their faces."""
        more = copy(self)
        more.part_faces = self.part_faces | faces_of
        return more

    def sample(
        self, vertices: np.ndarray, region: str, count: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Area-uniform points and unit normals (count, 3) of one region of a posed body."""
        return _sample_triangles(vertices[self.part_faces[region]], count, rng)


def choose_hypotheses(exemplars: Sequence[str], most: int, poses_per_exemplar: int) -> list[int]:
    """Indices of the best poses, at most so many of one exemplar, in their order of rank."""
    taken: dict[str, int] = {}
    chosen = []
    for index, name in enumerate(exemplars):
        if taken.get(name, 0) < poses_per_exemplar and len(chosen) < most:
            taken[name] = taken.get(name, 0) + 1
            chosen.append(index)
    return chosen


def build_problem(
    config: JointConfig,
    inputs: Inputs,
    interaction: Interaction,
    library: Sequence[Exemplar],
    regions: BodyRegions,
    seed: int,
    field: SignedDistanceGrid | None = None,
) -> Problem:
    """Gather one frame. Raises FrameFailure when the library lacks an exemplar of the fit.

    `field` is the same body's, where another interaction's problem has it already: a fifth of a
    second.
    """
    chosen = choose_hypotheses(inputs.exemplars, config.max_hypotheses, config.poses_per_exemplar)
    exemplars = _exemplars([inputs.exemplars[i] for i in chosen], library, inputs.category)
    geometry = _object_geometry(exemplars, config, inputs.size_axis, seed)
    if config.contact == "vertices":
        regions, pairs, skipped = _given_contact_pairs(config, inputs, geometry, regions)
    else:
        pairs, skipped = _contact_pairs(config, interaction, geometry, regions)
    body = _body_geometry(inputs.body_vertices, regions, pairs, config, seed, field)
    roi, resolution = inputs.roi, config.silhouette_resolution
    return Problem(
        start=_start(inputs, chosen, geometry.extent),
        object=geometry,
        body=body,
        contacts=pair_table(pairs, geometry.part_slices, body.slices),
        pairs=tuple(pairs),
        only_opposing=config.opposing_normals,
        opposing_first=config.contact != "paper",
        size=inputs.size,
        size_range=_size_range(inputs.extents) if config.size == "range" else None,
        human_scale_free=config.human_scale == "free",
        intrinsics=torch.from_numpy(intrinsics_for(roi, inputs.intrinsics, resolution)),
        target=_target(inputs, resolution, config.keep_threshold),
        edge_weight=config.edge_weight,
        pixel_weight=(config.weights_resolution / resolution) ** 2,
        stands_on_floor=interaction.stands_on_floor,
        feet_on_floor=interaction.feet_on_floor,
        up=torch.tensor([0.0, -1.0, 0.0]),
        penetration_points=config.paper_points,
        phosa=phosa_scene(config, inputs, regions),
        skipped=tuple(skipped),
    )


def _contact_pairs(
    config: JointConfig, interaction: Interaction, geometry: ObjectGeometry, regions: BodyRegions
) -> tuple[list[ContactPair], list[str]]:
    """Pairs of the method's rule, and one sentence for everything that could not be used."""
    if "contact" not in config.terms and "normal" not in config.terms:
        return [], []
    contacts, skipped = usable_contacts(interaction.contacts, geometry.part_slices, regions.names)
    if config.contact == "paper":
        pairs = paper_pairs(contacts)
    else:
        pairs = recipe_pairs(contacts, config.contact_rule)
    if config.no_contact == "weigh":
        share = 1 - interaction.no_contact
        pairs = [replace(pair, weight=share * pair.weight) for pair in pairs]
    return pairs, skipped + _missing_parts(pairs, geometry)


def _given_contact_pairs(
    config: JointConfig, inputs: Inputs, geometry: ObjectGeometry, regions: BodyRegions
) -> tuple[BodyRegions, list[ContactPair], list[str]]:
    """The same from contact probabilities per vertex; the regions gain the touching patches."""
    patches = given_patches(
        inputs.given_contacts,
        regions.faces,
        len(inputs.body_vertices),
        config.contact_threshold,
        config.contact_patches,
    )
    pairs = patch_pairs(patches, list(geometry.part_slices))
    skipped = [] if patches else [f"no vertex reaches contact {config.contact_threshold:g}"]
    return regions.with_faces({name: faces for name, (faces, _) in patches.items()}), pairs, skipped


def _start(inputs: Inputs, chosen: list[int], extent: Tensor) -> Tensor:
    """Poses of the object fit, scaled about the camera centre to the prior's size."""
    rotations = torch.from_numpy(inputs.rotations[chosen]).float()
    translations = torch.from_numpy(inputs.translations[chosen]).float()
    log_scale = torch.log(inputs.size / extent)[:, None]
    parts = [matrix_to_rotation_6d(rotations), translations, log_scale, torch.zeros_like(log_scale)]
    return torch.cat(parts, 1)


def _size_range(extents: Extents | None) -> tuple[Tensor, Tensor] | None:
    if extents is None:
        return None
    ranges = (extents.width, extents.height, extents.depth)
    low = torch.tensor([each.low if each else 0.0 for each in ranges])
    return low, torch.tensor([each.high if each else torch.inf for each in ranges])


def _exemplars(names: list[str], library: Sequence[Exemplar], category: str) -> list[Exemplar]:
    by_name = {exemplar.name: exemplar for exemplar in library}
    unknown = sorted(set(names) - set(by_name))
    if unknown:
        raise FrameFailure(
            "unknown_exemplar",
            f"the object fit used {', '.join(unknown)}, not in the {category} library",
        )
    return [by_name[name] for name in names]


def _object_geometry(
    exemplars: list[Exemplar], config: JointConfig, size_axis: str, seed: int
) -> ObjectGeometry:
    unique = list({exemplar.name: exemplar for exemplar in exemplars}.values())
    samples = {e.name: sample_parts(e, config.part_points, seed) for e in unique}
    parts = list(dict.fromkeys(part for e in unique for part in samples[e.name]))
    count = config.part_points
    nothing = np.zeros((count, 3), np.float32)

    def stacked(field: str) -> Tensor:
        rows = [
            np.concatenate(
                [
                    getattr(samples[e.name][part], field) if part in samples[e.name] else nothing
                    for part in parts
                ]
            )
            for e in exemplars
        ]
        return torch.from_numpy(np.stack(rows))

    present = np.array([[part in samples[e.name] for part in parts] for e in exemplars])
    surface = {e.name: _surface(e, config.surface_points, seed) for e in unique}
    most = max(len(e.vertices) for e in unique)
    padded = [
        np.concatenate([e.vertices, np.repeat(e.vertices[:1], most - len(e.vertices), 0)])
        for e in exemplars
    ]
    groups = []
    for e in unique:
        members = torch.tensor([k for k, other in enumerate(exemplars) if other.name == e.name])
        topology = MeshTopology.from_faces(e.faces, len(e.vertices))
        groups.append((topology, members, len(e.vertices)))
    axis = slice(1, 2) if size_axis == "height" else slice(0, 3)
    return ObjectGeometry(
        exemplars=exemplars,
        vertices=torch.from_numpy(np.stack(padded)),
        groups=groups,
        part_points=stacked("points"),
        part_normals=stacked("normals"),
        part_present=torch.from_numpy(np.repeat(present, count, 1)),
        part_slices={part: np.arange(i * count, (i + 1) * count) for i, part in enumerate(parts)},
        surface_points=torch.from_numpy(np.stack([surface[e.name] for e in exemplars])),
        extent=torch.tensor([float(e.size[axis].max()) for e in exemplars]),
        sizes=torch.from_numpy(np.stack([e.size for e in exemplars])),
    )


def _surface(exemplar: Exemplar, count: int, seed: int) -> np.ndarray:
    triangles = exemplar.vertices[exemplar.faces]
    return _sample_triangles(triangles, count, np.random.default_rng(seed))[0]


def _sample_triangles(
    triangles: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Area-uniform points and unit normals (count, 3) float32 on triangles (F, 3, 3)."""
    triangles = triangles.astype(np.float64)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    double_area = np.linalg.norm(cross, axis=1)
    chosen = rng.choice(len(triangles), count, p=double_area / double_area.sum())
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = triangles[chosen].transpose(1, 0, 2)
    normals = cross[chosen] / double_area[chosen, None]
    return (a + u * (b - a) + v * (c - a)).astype(np.float32), normals.astype(np.float32)


def _body_geometry(
    vertices: np.ndarray,
    regions: BodyRegions,
    pairs: Sequence[ContactPair],
    config: JointConfig,
    seed: int,
    field: SignedDistanceGrid | None,
) -> BodyGeometry:
    rng, count = np.random.default_rng(seed), config.part_points
    used = sorted({name for pair in pairs for name in pair.body_parts})
    samples = [regions.sample(vertices, name, count, rng) for name in used]
    empty = [np.zeros((0, 3), np.float32)]
    feet = [regions.vertices[name] for name in ("left_foot", "right_foot")]
    if field is None and "penetration" in config.terms:
        grid = config.sdf_grid
        field = body_signed_distance(vertices, regions.faces, grid, config.sdf_margin)
    return BodyGeometry(
        points=torch.from_numpy(np.concatenate([p for p, _ in samples] or empty)),
        normals=torch.from_numpy(np.concatenate([n for _, n in samples] or empty)),
        slices={name: np.arange(i * count, (i + 1) * count) for i, name in enumerate(used)},
        soles=torch.from_numpy(vertices[np.concatenate(feet)]),
        field=field,
    )


def _target(inputs: Inputs, resolution: int, keep_threshold: float) -> SilhouetteTarget:
    """Coverage of the object's mask; cells under the person or off the photo say nothing."""
    person = inputs.person_mask & ~inputs.object_mask
    known = crop_mask(~person, inputs.roi, resolution)
    covered = crop_mask(inputs.object_mask, inputs.roi, resolution)
    keep = np.where(known >= 1 - keep_threshold, known, 0)
    return SilhouetteTarget(covered / np.maximum(known, 1e-6), keep)


def _missing_parts(pairs: Sequence[ContactPair], geometry: ObjectGeometry) -> list[str]:
    """One sentence for each exemplar that lacks every object part of a pair."""
    notes = []
    for pair in pairs:
        rows = np.concatenate([geometry.part_slices[part] for part in pair.object_parts])
        lacks = ~geometry.part_present[:, rows].any(1)
        for k in torch.nonzero(lacks)[:, 0].tolist():
            parts = "/".join(pair.object_parts)
            notes.append(f"{geometry.exemplars[k].name} has no {parts}: no contact there")
    return list(dict.fromkeys(notes))
