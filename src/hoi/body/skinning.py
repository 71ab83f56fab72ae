"""Linear blend skinning of one body in plain numpy, where loading torch would cost more.

The stages use :class:`hoi.body.BodyModel`; tests hold both against each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hoi.body.files import BodyFile, SmplhFile


def skinned(
    data: BodyFile | SmplhFile, shaped: np.ndarray, rotations: np.ndarray, parents: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Posed vertices (V, 3) and joints (J, 3); SMPL's equations (Loper et al. 2015, Eqs. 2-10).

    Args:
        data: regressor, pose directions and weights of the model.
        shaped: (V, 3) at rest, metres; the root joint keeps its place.
        rotations: (J, 3, 3) of each joint against its parent.
        parents: of each joint, before it in the list; -1 for the root.
    """
    rest = data.joint_regressor @ shaped
    shaped = shaped + data.posedirs @ (rotations[1:] - np.eye(3)).ravel()
    world = np.empty_like(rotations)
    joints = np.empty_like(rest)
    for joint, parent in enumerate(parents):
        if parent < 0:
            world[joint], joints[joint] = rotations[joint], rest[joint]
            continue
        world[joint] = world[parent] @ rotations[joint]
        joints[joint] = joints[parent] + world[parent] @ (rest[joint] - rest[parent])
    offsets = joints - np.einsum("jab,jb->ja", world, rest)
    blended = np.einsum("vj,jab->vab", data.weights, world)
    return np.einsum("vab,vb->va", blended, shaped) + data.weights @ offsets, joints
