"""Edges of a triangle mesh, as the silhouette kernels need them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np


@dataclass(frozen=True, eq=False)
class MeshTopology:
    """Faces and edges of a mesh; computed once, shared by all its poses.

    An edge that belongs to more than two faces appears once for every two of them, so any triangle
    soup is described exactly: no manifoldness and no consistent winding is asked for.

    Attributes:
        faces: (F, 3) int32 vertex indices.
        edges: (E, 2) int32 vertex indices, lower index first.
        edge_faces: (E, 4) int32 rows ``face, direction, face, direction``; direction is +1 where
            the face runs along the edge from lower to higher index, -1 where it runs back, 0 where
            there is no second face.
        num_vertices: number of vertices that the faces index.
    """

    faces: np.ndarray
    edges: np.ndarray
    edge_faces: np.ndarray
    num_vertices: int

    @classmethod
    def from_faces(cls, faces: np.ndarray, num_vertices: int) -> Self:
        """Build the edge table of `faces` (F, 3); raises ValueError on bad shapes or indices."""
        faces = np.ascontiguousarray(faces, dtype=np.int32)
        if faces.ndim != 2 or faces.shape[1] != 3:
            raise ValueError(f"faces have shape {faces.shape}, expected (F, 3)")
        if faces.size and (faces.min() < 0 or faces.max() >= num_vertices):
            raise ValueError(
                f"faces index vertices {faces.min()}..{faces.max()}, the mesh has {num_vertices}"
            )
        start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        face = np.repeat(np.arange(len(faces), dtype=np.int32), 3)
        proper = start != end
        start, end, face = start[proper], end[proper], face[proper]
        direction = np.where(start < end, 1, -1).astype(np.int32)
        key = np.minimum(start, end).astype(np.int64) * num_vertices + np.maximum(start, end)

        order = np.argsort(key, kind="stable")
        key, face, direction = key[order], face[order], direction[order]
        first_of_edge = np.flatnonzero(np.r_[True, key[1:] != key[:-1]]) if len(key) else key
        rank = np.arange(len(key)) - np.repeat(
            first_of_edge, np.diff(np.r_[first_of_edge, len(key)])
        )
        opens_pair = rank % 2 == 0
        row = np.cumsum(opens_pair) - 1
        count = int(opens_pair.sum())
        edge_faces = np.zeros((count, 4), np.int32)
        edge_faces[row[opens_pair], 0] = edge_faces[row[opens_pair], 2] = face[opens_pair]
        edge_faces[row[opens_pair], 1] = direction[opens_pair]
        edge_faces[row[~opens_pair], 2] = face[~opens_pair]
        edge_faces[row[~opens_pair], 3] = direction[~opens_pair]
        pair_key = key[opens_pair]
        edges = np.stack(
            [pair_key // max(num_vertices, 1), pair_key % max(num_vertices, 1)], axis=1
        )
        return cls(faces, np.ascontiguousarray(edges, np.int32), edge_faces, int(num_vertices))
