"""BEHAVE's ground truth: fitted bodies and objects in the frame of one Kinect.

Fits come as meshes (``person_fit.ply``, ``<object>_fit.ply``), as parameters (``.pkl``) or, for the
30 fps extension, as parameters of a whole sequence. Meshes are taken where they exist.
"""

from __future__ import annotations

import functools
import json
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from PIL import Image

from hoi.artifacts import GroundTruth
from hoi.datasets.behave_30fps import Fit, fit_files, read_fit
from hoi.datasets.behave_calibration import (
    extrinsics_file,
    info_file,
    sequence_info,
    world_to_camera,
)
from hoi.datasets.behave_config import BehaveConfig
from hoi.datasets.behave_layout import FrameRef, frame_folder, object_folder_names
from hoi.datasets.pictures import read_mask
from hoi.errors import FrameFailure
from hoi.plain_pickle import load_plain

if TYPE_CHECKING:
    from hoi.body.smplh import SmplhModel

_PERSON = ("person/fit02/person_fit",)
_POSE_LENGTH = 156  # 52 joints of SMPL-H
#: Metres between a stored mesh and its posed parameters beyond which they are not the same body.
_SAME_BODY = 0.01


class _Mesh(NamedTuple):
    vertices: np.ndarray
    faces: np.ndarray


class _Person(NamedTuple):
    mesh: _Mesh
    joints: np.ndarray | None
    model: str


# -------------------------------------------------------------------------------------- files


def object_fits(ref: FrameRef) -> tuple[str, ...]:
    """Stems under which a frame's object fit may lie, most usual first."""
    return tuple(f"{n}/fit01/{n}_fit" for n in object_folder_names(ref.object_name))


def fit_file(root: Path | str, ref: FrameRef, stems: Sequence[str]) -> Path | None:
    """The fit of one frame, the mesh before the parameters, or None."""
    folder = frame_folder(root, ref)
    for stem in stems:
        for suffix in (".ply", ".pkl"):
            path = folder / f"{stem}{suffix}"
            if path.is_file():
                return path
    return None


def person_fit(root: Path | str, ref: FrameRef) -> Path | None:
    """The body fit of one frame, or None."""
    return fit_file(root, ref, _PERSON)


def object_fit(root: Path | str, ref: FrameRef) -> Path | None:
    """The object fit of one frame, or None."""
    return fit_file(root, ref, object_fits(ref))


def picture(folder: Path, stem: str) -> Path | None:
    """A mask as png or jpg, whichever exists."""
    return next((p for s in (".png", ".jpg") if (p := folder / f"{stem}{s}").is_file()), None)


def object_mask(folder: Path, kinect: int) -> Path | None:
    """The mask of the visible object: rendered from the fit, else segmented."""
    rendered = picture(folder, f"k{kinect}.obj_rend_mask")
    return rendered or picture(folder, f"k{kinect}.obj_mask")


def template_file(root: Path | str, object_name: str) -> Path | None:
    """The simplified scan that an object's pose parameters refer to.

    ``<object>_fNNNN.ply``; ``monitor_closed_f1000.ply`` is the one with another name.
    """
    folder = Path(root) / "objects" / object_name
    named = sorted(folder.glob(f"{object_name}_f[0-9]*.ply"))
    candidates = named or sorted(folder.glob("*_f[0-9]*.ply"))
    return candidates[0] if candidates else None


def ground_truth_files(
    root: Path | str, ref: FrameRef, config: BehaveConfig | None = None
) -> list[Path]:
    """The existing files that :func:`read_ground_truth` depends on, sorted, for hashing."""
    config = config or BehaveConfig()
    folder, person = frame_folder(root, ref), frame_folder(root, ref) / "person" / "fit02"
    found = [
        object_mask(folder, config.kinect),
        picture(folder, f"k{config.kinect}.obj_rend_full"),
        extrinsics_file(root, ref.sequence, config.kinect),
        info_file(root, ref.sequence),
    ]
    if config.fits_30fps:
        found += [
            *fit_files(Path(config.fits_30fps).expanduser(), ref.sequence),
            template_file(root, ref.object_name),
        ]
    else:
        body, thing = person_fit(root, ref), object_fit(root, ref)
        found += [body, thing, person / "person_fit.json", person / "person_J.ply"]
        if thing is not None and thing.suffix == ".pkl":
            found.append(template_file(root, ref.object_name))
    if config.smplh:
        found += [person / "person_fit.pkl", _model_file(root, ref, config)]
    return sorted(path for path in found if path is not None and path.is_file())


def _model_file(root: Path | str, ref: FrameRef, config: BehaveConfig) -> Path:
    """The SMPL-H file of the subject's gender; raises AssetError."""
    from hoi.body.smplh import smplh_path

    assert config.smplh is not None
    gender = sequence_info(root, ref.sequence).gender
    return smplh_path(Path(config.smplh).expanduser(), gender)


# ------------------------------------------------------------------------------------ reading


def read_ground_truth(
    root: Path | str, ref: FrameRef, config: BehaveConfig | None = None
) -> GroundTruth:
    """The fitted meshes in the frame of the configured Kinect.

    `body_joints` come from ``person_fit.json``, ``person_J.ply`` or, with `smplh` configured, from
    the parameters; else they are None.

    Raises FrameFailure: ground_truth_missing, ground_truth_unreadable, ground_truth_inconsistent,
    calibration_unreadable, sequence_info_unreadable. Raises AssetError for an SMPL-H model that is
    configured but absent or damaged.
    """
    config = config or BehaveConfig()
    if config.fits_30fps:
        fit = read_fit(Path(config.fits_30fps).expanduser(), ref)
        person = _posed_person(root, ref, config, fit)
        thing = _placed_template(root, ref, fit.object_angle, fit.object_trans)
    else:
        person, thing = _stored_person(root, ref, config), _stored_object(root, ref)
    to_camera = world_to_camera(extrinsics_file(root, ref.sequence, config.kinect))
    return GroundTruth(
        frame_id=ref.frame_id,
        body_model=person.model,
        body_vertices=to_camera(person.mesh.vertices),
        body_faces=person.mesh.faces,
        body_joints=None if person.joints is None else to_camera(person.joints),
        object_vertices=to_camera(thing.vertices),
        object_faces=thing.faces,
        visible_fraction=_visible_fraction(frame_folder(root, ref), config.kinect),
    )


def _stored_person(root: Path | str, ref: FrameRef, config: BehaveConfig) -> _Person:
    stored = person_fit(root, ref)
    if stored is None:
        raise FrameFailure("ground_truth_missing", f"{ref.frame_id} has no person fit")
    if stored.suffix == ".pkl":
        if not config.smplh:
            raise FrameFailure(
                "ground_truth_missing",
                f"{ref.frame_id} has person_fit.pkl but no person_fit.ply; its parameters need "
                "SMPL-H: set behave.smplh",
            )
        return _posed_person(root, ref, config, person_parameters(stored))
    mesh = read_mesh(stored)
    described = stored.with_name("person_fit.json")
    if described.is_file():
        return _Person(mesh, *_described(described))
    joints = _joints_of_cloud(stored.with_name("person_J.ply"))
    parameters = stored.with_suffix(".pkl")
    if config.smplh and parameters.is_file():
        joints = _joints_of_parameters(root, ref, config, parameters, mesh)
    return _Person(mesh, joints, _topology(mesh))


def _stored_object(root: Path | str, ref: FrameRef) -> _Mesh:
    stored = object_fit(root, ref)
    if stored is None:
        raise FrameFailure("ground_truth_missing", f"{ref.frame_id} has no object fit")
    if stored.suffix == ".ply":
        return read_mesh(stored)
    pose = _numbers(stored, {"angle": 3, "trans": 3})
    return _placed_template(root, ref, pose["angle"], pose["trans"])


def _placed_template(
    root: Path | str, ref: FrameRef, angle: np.ndarray, trans: np.ndarray
) -> _Mesh:
    """The simplified scan, centred on the mean of its vertices, turned and moved."""
    from scipy.spatial.transform import Rotation

    template = centred_template(root, ref.object_name)
    turned = template.vertices @ Rotation.from_rotvec(angle).as_matrix().T
    return _Mesh((turned + trans).astype(np.float32), template.faces)


def centred_template(root: Path | str, object_name: str) -> _Mesh:
    """The simplified scan with the mean of its vertices, as stored, at the origin (float64).

    Raises FrameFailure ground_truth_missing or ground_truth_unreadable.
    """
    path = template_file(root, object_name)
    if path is None:
        raise FrameFailure(
            "ground_truth_missing", f"objects/{object_name} has no simplified scan (*_fNNNN.ply)"
        )
    template = read_mesh(path)
    vertices = template.vertices.astype(float)
    return _Mesh(vertices - vertices.mean(axis=0), template.faces)


def read_mesh(path: Path) -> _Mesh:
    """Vertices (V, 3) float32 and faces (F, 3) exactly as stored: none merged, none reordered.

    Raises FrameFailure ground_truth_unreadable.
    """
    import trimesh

    try:
        mesh: Any = trimesh.load(path, process=False, force="mesh")
        vertices = np.asarray(mesh.vertices, np.float32)
        faces = np.asarray(mesh.faces, np.int64)
    except Exception as error:  # the mesh loader raises whatever its parser met
        raise FrameFailure("ground_truth_unreadable", f"{path.name}: {error!r}") from error
    fits = len(faces) and faces.min() >= 0 and faces.max() < len(vertices)
    if not fits or not np.isfinite(vertices).all():
        raise FrameFailure("ground_truth_unreadable", f"{path.name} holds no mesh")
    return _Mesh(vertices, faces)


def _visible_fraction(folder: Path, kinect: int) -> float | None:
    """Visible over full object silhouette, or None when a mask is not there.

    Full masks may come at another resolution, so shares of the picture are compared.
    """
    visible, full = object_mask(folder, kinect), picture(folder, f"k{kinect}.obj_rend_full")
    if visible is None or full is None:
        return None
    try:
        share, whole = (read_mask(path, _size(path)).mean() for path in (visible, full))
    except FrameFailure:
        return None
    return float(min(share / whole, 1.0)) if whole else None


def _size(path: Path) -> tuple[int, int]:
    try:
        with Image.open(path) as image:
            return image.height, image.width
    except (OSError, ValueError, SyntaxError) as error:
        raise FrameFailure("mask_unreadable", f"{path.name}: {error}") from error


# ------------------------------------------------------------------------------------- bodies


def _posed_person(
    root: Path | str, ref: FrameRef, config: BehaveConfig, fit: Fit | Parameters
) -> _Person:
    """The body that SMPL-H parameters describe."""
    from hoi.body.smplh import SMPL_JOINTS

    if not config.smplh:
        raise FrameFailure(
            "ground_truth_missing",
            f"{ref.frame_id}: body parameters need SMPL-H: set behave.smplh",
        )
    model = _model(_model_file(root, ref, config))
    posed = model.pose(fit.pose, fit.betas, fit.trans, config.smplh_root)
    mesh = _Mesh(posed.vertices.astype(np.float32), model.faces)
    return _Person(mesh, posed.joints[list(SMPL_JOINTS)].astype(np.float32), _topology(mesh))


def _joints_of_parameters(
    root: Path | str, ref: FrameRef, config: BehaveConfig, path: Path, mesh: _Mesh
) -> np.ndarray:
    """Joints of the stored parameters, moved onto the stored mesh of the same body.

    Moved, so that the joints are right whichever root convention the parameters follow.
    """
    posed = _posed_person(root, ref, config, person_parameters(path))
    assert posed.joints is not None
    if posed.mesh.vertices.shape != mesh.vertices.shape:
        raise FrameFailure(
            "ground_truth_inconsistent",
            f"{ref.frame_id}: person_fit.ply has {len(mesh.vertices)} vertices, the SMPL-H model "
            f"has {len(posed.mesh.vertices)}",
        )
    apart = mesh.vertices - posed.mesh.vertices
    shift = apart.mean(axis=0)
    worst = float(np.linalg.norm(apart - shift, axis=1).max())
    if worst > _SAME_BODY:
        raise FrameFailure(
            "ground_truth_inconsistent",
            f"{ref.frame_id}: person_fit.pkl posed by {_model_file(root, ref, config).name} is up "
            f"to {100 * worst:.1f} cm from person_fit.ply; is the gender in info.json right?",
        )
    return posed.joints + shift


@functools.lru_cache(maxsize=3)
def _model(path: Path) -> SmplhModel:
    from hoi.body.smplh import SmplhModel

    return SmplhModel.load(path)


class Parameters(NamedTuple):
    """SMPL-H parameters of one body: pose (156,) radians, betas (10,), trans (3,) metres."""

    pose: np.ndarray
    betas: np.ndarray
    trans: np.ndarray


def person_parameters(path: Path) -> Parameters:
    """``person_fit.pkl``; raises FrameFailure ground_truth_unreadable."""
    found = _numbers(path, {"pose": _POSE_LENGTH, "betas": 10, "trans": 3})
    return Parameters(found["pose"], found["betas"], found["trans"])


def _numbers(path: Path, lengths: dict[str, int]) -> dict[str, np.ndarray]:
    """Named vectors of a pickle; raises FrameFailure ground_truth_unreadable with the key."""

    def unreadable(what: object) -> FrameFailure:
        return FrameFailure("ground_truth_unreadable", f"{path.name}: {what}")

    try:
        content = load_plain(path)
    except (pickle.UnpicklingError, OSError) as error:
        raise unreadable(error) from error
    found = {}
    for key, length in lengths.items():
        if key not in content:
            raise unreadable(f"the key {key!r} is missing")
        try:
            values = np.asarray(content[key], float).ravel()
        except (ValueError, TypeError) as error:
            raise unreadable(f"the key {key!r} holds no numbers") from error
        if len(values) != length or not np.isfinite(values).all():
            raise unreadable(f"the key {key!r} holds {len(values)} numbers, expected {length}")
        found[key] = values
    return found


def _described(path: Path) -> tuple[np.ndarray, str]:
    """Joints (24, 3) and model identity, as the generated set writes them."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        joints = np.asarray(content["joints"], np.float32)
        if joints.shape != (24, 3) or not np.isfinite(joints).all():
            raise ValueError(f"joints have shape {joints.shape}")
        return joints, str(content["body_model"])
    except (ValueError, KeyError, TypeError, OSError, RecursionError) as error:
        raise FrameFailure("ground_truth_unreadable", f"{path.name}: {error!r}") from error


def _joints_of_cloud(path: Path) -> np.ndarray | None:
    """SMPL's 24 joints of ``person_J.ply`` (52 of SMPL-H, or 24), None where it is not there."""
    if not path.is_file():
        return None
    import trimesh

    from hoi.body.smplh import SMPL_JOINTS

    try:
        cloud: Any = trimesh.load(path, process=False)
        joints = np.asarray(cloud.vertices, np.float32)
    except Exception as error:  # the mesh loader raises whatever its parser met
        raise FrameFailure("ground_truth_unreadable", f"{path.name}: {error!r}") from error
    if len(joints) >= 52:
        return joints[list(SMPL_JOINTS)]
    return joints if len(joints) == 24 else None


def _topology(mesh: _Mesh) -> str:
    from hoi.body.topology import topology

    return topology(mesh.faces, len(mesh.vertices))
