"""How a reconstruction is brought to the truth before distances are taken.

Vertices are matched by index only where both meshes have the same connectivity, which is compared
itself; equal vertex counts prove nothing. Bodies of different topology are matched by their 24
joints.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from hoi.artifacts import GroundTruth, Joint
from hoi.body.topology import topology
from hoi.errors import FrameFailure
from hoi.geometry.alignment import sample_surface, similarity_procrustes

_ROUNDS = 30  # of closest points; further ones move an object by less than its sampling noise
_SETTLED = 1e-4  # metres


class Scene(NamedTuple):
    """One reconstruction and its truth, with the faces of the fitted body."""

    truth: GroundTruth
    joint: Joint
    body_faces: np.ndarray


class Similarity(NamedTuple):
    """Brings reconstructed points X to the truth: ``scale * X @ rotation.T + translation``."""

    scale: float
    rotation: np.ndarray
    translation: np.ndarray
    how: str  # named in the tables

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return self.scale * points @ self.rotation.T + self.translation


def align(name: str, scene: Scene, seed: int) -> Similarity:
    """The transform of one protocol (a value of `EvaluateConfig.align`).

    Raises FrameFailure no_correspondence where bodies of different topology come without joints.
    """
    if name == "none":
        return Similarity(1.0, np.eye(3), np.zeros(3), "no alignment")
    if name == "body":
        return _on_body(scene)
    if name == "surfaces":
        return _on_surfaces(scene, seed)
    return _on_both(scene)


def bodies_correspond(scene: Scene) -> bool:
    """Whether vertex k is the same place of both bodies."""
    truth, joint = scene.truth, scene.joint
    assert truth.body_vertices is not None and truth.body_faces is not None
    assert joint.body_vertices is not None
    if truth.body_model and truth.body_model == joint.body_model:
        return True
    return topology(truth.body_faces, len(truth.body_vertices)) == topology(
        scene.body_faces, len(joint.body_vertices)
    )


def _objects_correspond(scene: Scene) -> bool:
    truth, joint = scene.truth, scene.joint
    assert truth.object_vertices is not None and truth.object_faces is not None
    assert joint.object_vertices is not None and joint.object_faces is not None
    return topology(truth.object_faces, len(truth.object_vertices)) == topology(
        joint.object_faces, len(joint.object_vertices)
    )


def _body_points(scene: Scene) -> tuple[np.ndarray, np.ndarray, str]:
    """Corresponding points of the fitted and the true body."""
    truth, joint = scene.truth, scene.joint
    if bodies_correspond(scene):
        assert joint.body_vertices is not None and truth.body_vertices is not None
        return joint.body_vertices, truth.body_vertices, "body vertices"
    if truth.body_joints is None or joint.body_joints is None:
        raise FrameFailure(
            "no_correspondence",
            f"the true body ({truth.body_model or 'unnamed'}) is not the fitted model "
            f"({joint.body_model}) and comes without its 24 joints; for BEHAVE, behave.smplh or an "
            "SMPL file as assets.body_model gives the correspondence",
        )
    return joint.body_joints, truth.body_joints, "24 joints"


def _on_body(scene: Scene) -> Similarity:
    source, target, what = _body_points(scene)
    return Similarity(*similarity_procrustes(source, target), f"Procrustes on {what}")


def _on_both(scene: Scene) -> Similarity:
    """All vertices stacked where both meshes correspond, else the body alone, as CHORE's
    evaluation does for objects that are not its templates."""
    truth, joint = scene.truth, scene.joint
    if not (_objects_correspond(scene) and bodies_correspond(scene)):
        body = _on_body(scene)
        return body._replace(how=f"{body.how} (meshes do not correspond, so not on the object)")
    assert joint.body_vertices is not None and joint.object_vertices is not None
    assert truth.body_vertices is not None and truth.object_vertices is not None
    source = np.concatenate([joint.body_vertices, joint.object_vertices]).astype(float)
    target = np.concatenate([truth.body_vertices, truth.object_vertices]).astype(float)
    how = "Procrustes on body and object vertices"
    return Similarity(*similarity_procrustes(source, target), how)


def _on_surfaces(scene: Scene, seed: int) -> Similarity:
    """Body correspondences and the object's closest points, until they settle.

    Every true object vertex is matched with the closest sampled point of the aligned
    reconstruction. The body counts by the vertices of its true mesh and the object by those of
    its own, as if all of them were stacked.
    """
    truth, joint = scene.truth, scene.joint
    assert joint.object_vertices is not None and joint.object_faces is not None
    assert truth.body_vertices is not None and truth.object_vertices is not None
    source, target, what = _body_points(scene)
    thing = sample_surface(
        joint.object_vertices, joint.object_faces, 5000, np.random.default_rng(seed)
    )
    true_thing = truth.object_vertices.astype(float)
    weights = np.repeat(
        [len(truth.body_vertices) / len(source), 1.0], [len(source), len(true_thing)]
    )
    wanted = np.concatenate([target, true_thing])
    found = _on_body(scene)
    for _ in range(_ROUNDS):
        matched = thing[KDTree(found(thing)).query(true_thing)[1]]
        stacked = np.concatenate([source, matched])
        before = found(stacked)
        found = Similarity(*_weighted(stacked, wanted, weights), "")
        if np.abs(found(stacked) - before).max() < _SETTLED:
            break
    return found._replace(how=f"Procrustes on {what} and closest object points")


def _weighted(source: np.ndarray, target: np.ndarray, weights: np.ndarray):
    """Umeyama's similarity with a weight for each pair of points."""
    share = (weights / weights.sum())[:, None]
    source_mean, target_mean = (share * source).sum(0), (share * target).sum(0)
    x, y = source - source_mean, target - target_mean
    u, singular, vt = np.linalg.svd((share * y).T @ x)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * sign) @ vt
    scale = float((singular * sign).sum() / (share * x**2).sum())
    return scale, rotation, target_mean - scale * source_mean @ rotation.T
