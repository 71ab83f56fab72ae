"""Which body vertices touch the object, and how many of them a reconstruction finds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from hoi.artifacts import ContactScore
from hoi.evaluate.alignment import Scene, Similarity, bodies_correspond
from hoi.geometry.alignment import sample_surface


def contact_scores(
    scene: Scene,
    thresholds_cm: Sequence[float],
    samples: int,
    to_truth: Similarity | None,
    seed: int,
) -> list[ContactScore]:
    """Precision and recall of touching body vertices, at several distances.

    A vertex touches when it is nearer to `samples` points of the object's surface than the
    threshold, in each scene's own metres; how scenes are aligned does not matter. Where the bodies
    have different topologies, a fitted vertex inherits the truth of the nearest true vertex after
    `to_truth`; None leaves such frames without scores.
    """
    truth, joint = scene.truth, scene.joint
    assert joint.body_vertices is not None and truth.body_vertices is not None
    assert joint.object_vertices is not None and joint.object_faces is not None
    assert truth.object_vertices is not None and truth.object_faces is not None

    def distances(body: np.ndarray, vertices: np.ndarray, faces: np.ndarray, draw: int):
        points = sample_surface(vertices, faces, samples, np.random.default_rng(draw))
        return KDTree(points).query(body)[0]

    if bodies_correspond(scene):
        origin, how = slice(None), "body vertices"
    elif to_truth is not None:
        origin = KDTree(truth.body_vertices).query(to_truth(joint.body_vertices))[1]
        how = "nearest true vertex after alignment"
    else:
        return []
    found = distances(joint.body_vertices, joint.object_vertices, joint.object_faces, seed)
    true = distances(truth.body_vertices, truth.object_vertices, truth.object_faces, seed + 1)
    return [
        _score(found < limit / 100, true[origin] < limit / 100, limit, how)
        for limit in thresholds_cm
    ]


def _score(found: np.ndarray, true: np.ndarray, limit: float, how: str) -> ContactScore:
    right = float((found & true).sum())
    return ContactScore(
        threshold_cm=limit,
        precision=right / found.sum() if found.any() else None,
        recall=right / true.sum() if true.any() else None,
        correspondence=how,
    )
