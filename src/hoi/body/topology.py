"""Which meshes have corresponding vertices."""

from __future__ import annotations

import hashlib

import numpy as np


def topology(faces: np.ndarray, num_vertices: int) -> str:
    """One name for a mesh's connectivity: equal names mean that vertices correspond by index.

    Equal vertex counts prove nothing, and shapes may differ: SMPL, SMPL-H and all their genders
    share one list of faces, and so one name.
    """
    digest = hashlib.sha256(np.ascontiguousarray(faces, dtype="<i8").tobytes())
    return f"mesh-{num_vertices}v-{digest.hexdigest()[:16]}"
