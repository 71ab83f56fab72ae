"""SMPL-H with its fingers: what BEHAVE's person parameters pose. Plain numpy, one body at a time.

The equations are those of SMPL (Loper et al. 2015, Eqs. 2-10) over 52 joints; the stages use the
24-joint :class:`hoi.body.BodyModel`, so this module is needed for ground truth only.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from hoi.body.files import SmplhFile, read_smplh_file
from hoi.body.skinning import skinned
from hoi.errors import AssetError

#: How the translation places the root. `model`: the root joint keeps its place in the template,
#: then `trans` is added, as in SMPL. `centred`: the root joint lies at `trans` itself.
RootConvention = Literal["model", "centred"]
#: Middle knuckles, the nearest that SMPL-H has to SMPL's joints left_hand and right_hand.
HANDS = (25, 40)
#: SMPL's 24 joints among SMPL-H's 52.
SMPL_JOINTS = (*range(22), *HANDS)
GENDERS = ("female", "male", "neutral")
_NAMES = ("SMPLH_{gender}.pkl", "SMPLH_{GENDER}.pkl", "SMPLH_{gender}.npz", "SMPLH_{GENDER}.npz",
          "{gender}/model.npz", "{GENDER}/model.npz")  # fmt: skip


class PosedBody(NamedTuple):
    """Vertices (V, 3) and joints (52, 3), metres."""

    vertices: np.ndarray
    joints: np.ndarray


def smplh_path(folder: Path | str, gender: str) -> Path:
    """The model file of one gender in a folder of SMPL-H models; raises AssetError."""
    folder = Path(folder)
    if gender not in GENDERS:
        raise AssetError(f"unknown gender {gender!r}; SMPL-H has {', '.join(GENDERS)}")
    names = [name.format(gender=gender, GENDER=gender.upper()) for name in _NAMES]
    for name in names:
        if (folder / name).is_file():
            return folder / name
    raise AssetError(f"{folder}: no SMPL-H model of gender {gender}; expected {', '.join(names)}")


class SmplhModel:
    """One gendered SMPL-H model."""

    def __init__(self, data: SmplhFile):
        self.data = data
        self.faces = data.faces

    @classmethod
    def load(cls, path: Path | str) -> SmplhModel:
        """Read a model file; raises AssetError."""
        return cls(read_smplh_file(path))

    def pose(
        self,
        pose: np.ndarray,
        betas: np.ndarray,
        trans: np.ndarray,
        root: RootConvention = "model",
    ) -> PosedBody:
        """The posed body.

        Args:
            pose: (156,) axis-angle radians of 52 joints, the root first; as BEHAVE stores it,
                without a mean hand pose to add.
            betas: (K,) shape, K at most what the model has.
            trans: (3,) metres.
            root: how `trans` is meant.
        """
        data = self.data
        shaped = data.v_template + data.shapedirs[..., : len(betas)] @ betas
        local = Rotation.from_rotvec(np.reshape(pose, (-1, 3))).as_matrix()
        vertices, joints = skinned(data, shaped, local, data.parents)
        shift = np.asarray(trans, float) - (joints[0] if root == "centred" else 0.0)
        return PosedBody(vertices + shift, joints + shift)
