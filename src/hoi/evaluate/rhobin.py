"""Results in the format of the RHOBIN challenge (CVPR 2023), joint reconstruction track.

``results.pkl`` holds, by sequence: frames, gender, poses (T, 72), betas (T, 10), trans (T, 3),
obj_rots (T, 3, 3), obj_trans (T, 3) and obj_scales, in the frame of Kinect 1 and metres. The
challenge places the data set's own template at ``(R v + t) * scale``, v centred on the mean of its
vertices. This method's objects are other meshes, so the template is registered to each of them.
"""

from __future__ import annotations

import itertools
import pickle
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from hoi.artifacts import BodyFit, Joint
from hoi.errors import ConfigError
from hoi.geometry.alignment import sample_surface, similarity_procrustes

Mesh = tuple[np.ndarray, np.ndarray]
_COARSE, _FINE = 250, 1500  # surface samples
_STARTS_KEPT = 4


@dataclass
class Submission:
    """Collects frames and writes ``results.pkl``.

    Attributes:
        sequences: what the challenge asks for, by sequence name.
        templates: object name -> its template, vertices centred on their mean.
    """

    templates: dict[str, Mesh]
    seed: int = 0
    with_vertices: bool = False
    sequences: dict[str, dict[str, Any]] = field(default_factory=dict)
    _registered: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def add(
        self, sequence: str, time: str, object_name: str, gender: str, body: BodyFit, joint: Joint
    ) -> None:
        """Append one frame with a result."""
        assert body.global_orient is not None and body.body_pose is not None
        assert body.betas is not None and body.transl is not None
        assert joint.object_vertices is not None and joint.object_faces is not None
        placed = self._placed_template(object_name, joint)
        # the body's parameters have no scale, so the whole scene is brought to a body of scale one
        # about the camera, which changes no picture
        scale, rotation, translation = similarity_procrustes(
            self.templates[object_name][0], placed / (joint.human_scale or 1.0)
        )
        rows = self.sequences.setdefault(sequence, {"gender": gender})
        betas = np.zeros(10)
        betas[: min(10, len(body.betas))] = body.betas[:10]
        frame = {
            "frames": time,
            "poses": np.concatenate([body.global_orient, body.body_pose]),
            "betas": betas,
            "trans": body.transl,
            "obj_rots": rotation,
            "obj_trans": translation / scale,
            "obj_scales": scale,
        }
        if self.with_vertices:
            frame |= {"smpl_verts": joint.body_vertices, "obj_verts": placed.astype(np.float32)}
        for key, value in frame.items():
            rows.setdefault(key, []).append(value)

    def content(self) -> dict[str, dict[str, Any]]:
        """What the file holds: lists of times and scales, arrays of everything else."""
        plain = ("frames", "gender", "obj_scales")
        return {
            sequence: {
                key: value if key in plain else np.stack(value) for key, value in rows.items()
            }
            for sequence, rows in sorted(self.sequences.items())
        }

    def save(self, path: Path) -> None:
        """Write the pickle, readable with numpy 1 and 2 alike."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(portable_pickle(self.content()))

    def _placed_template(self, object_name: str, joint: Joint) -> np.ndarray:
        """The template's vertices where they fit the reconstructed object best (camera frame).

        Registered once for each pair of template and exemplar; other frames show the same
        exemplar moved by a similarity, which is exact.
        """
        assert joint.object_vertices is not None and joint.object_faces is not None
        if object_name not in self.templates:
            raise ConfigError(f"there is no template of {object_name}")
        key = (object_name, joint.exemplar)
        if key not in self._registered:
            template = self.templates[object_name]
            fitted = register(template, (joint.object_vertices, joint.object_faces), self.seed)
            self._registered[key] = (joint.object_vertices.astype(float), fitted)
        first, fitted = self._registered[key]
        scale, rotation, translation = similarity_procrustes(
            first, joint.object_vertices.astype(float)
        )
        return scale * fitted @ rotation.T + translation


def register(source: Mesh, target: Mesh, seed: int) -> np.ndarray:
    """Vertices of `source` under the similarity that brings its surface nearest to `target`'s.

    Iterated closest points, both ways, from the 24 ways to match principal axes and as many
    random rotations; the smallest sum of both mean distances wins.
    """
    rng = np.random.default_rng(seed)
    starts = _starts(source, target, rng)
    coarse = (sample_surface(*source, _COARSE, rng), sample_surface(*target, _COARSE, rng))
    scored = sorted(
        (_closest_points(*coarse, start, rounds=12) for start in starts), key=lambda found: found[0]
    )
    fine = (sample_surface(*source, _FINE, rng), sample_surface(*target, _FINE, rng))
    best = min(
        (_closest_points(*fine, found[1], rounds=40) for found in scored[:_STARTS_KEPT]),
        key=lambda found: found[0],
    )
    scale, rotation, translation = best[1]
    return scale * source[0].astype(float) @ rotation.T + translation


def _starts(source: Mesh, target: Mesh, rng: np.random.Generator):
    frames = []
    for mesh in (source, target):
        points = sample_surface(*mesh, _FINE, rng)
        centre = points.mean(0)
        _, lengths, axes = np.linalg.svd(points - centre, full_matrices=False)
        frames.append((centre, axes.T * [1, 1, np.sign(np.linalg.det(axes))], lengths))
    (centre, axes, lengths), (true_centre, true_axes, true_lengths) = frames
    scale = float(np.linalg.norm(true_lengths) / np.linalg.norm(lengths))
    turns = [
        true_axes @ turn @ axes.T
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1, -1), repeat=3)
        if np.linalg.det(turn := np.eye(3)[list(order)] * signs) > 0
    ]
    turns += list(Rotation.from_quat(rng.normal(size=(len(turns), 4))).as_matrix())
    return [(scale, turn, true_centre - scale * centre @ turn.T) for turn in turns]


def _closest_points(source: np.ndarray, target: np.ndarray, start, rounds: int):
    """Sum of both mean distances after some rounds, and the similarity."""
    scale, rotation, translation = start
    tree, error = KDTree(target), np.inf
    for _ in range(rounds):
        moved = scale * source @ rotation.T + translation
        there, nearest = tree.query(moved)
        back, owner = KDTree(moved).query(target)
        previous, error = error, float(there.mean() + back.mean())
        if previous - error < 1e-6:
            break
        pairs = np.concatenate([source, source[owner]]), np.concatenate([target[nearest], target])
        scale, rotation, translation = similarity_procrustes(*pairs)
    return error, (scale, rotation, translation)


def portable_pickle(content: Any) -> bytes:
    """A pickle of plain data that numpy 1 can read, too: numpy 2 renamed its array makers."""
    data = pickle.dumps(content, protocol=2)
    for module in (b"multiarray", b"numeric"):
        data = data.replace(b"cnumpy._core." + module + b"\n", b"cnumpy.core." + module + b"\n")
    return data
