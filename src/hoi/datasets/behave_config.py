"""Settings of the BEHAVE data set: where it lies and how it is read."""

from typing import Literal

from pydantic import Field, PositiveInt

from hoi.settings import Settings


class BehaveConfig(Settings):
    """The licensed data set, when the user has it; see docs/behave.md."""

    root: str | None = Field(
        default=None, description="folder with split.json, sequences/, objects/, calibs/"
    )
    kinect: Literal[0, 1, 2, 3] = Field(
        default=1, description="the camera; later papers test on 1, whose frame is the world"
    )
    dates: tuple[str, ...] = Field(
        default=(), description="keep sequences of these dates, e.g. [Date03]; empty: all"
    )
    every: PositiveInt = Field(
        default=1, description="keep every n-th frame of each sequence (1 fps in the released set)"
    )
    frame_list: str | None = Field(
        default=None,
        description="file that lists the frames to use in place of split.json: text, json or "
        "pickle with paths .../<sequence>/<time>[/k1.color.jpg], by split or plain",
    )
    smplh: str | None = Field(
        default=None,
        description="folder of SMPL-H models (SMPLH_male.pkl, SMPLH_female.pkl): gives the true "
        "joints, and bodies where a frame has person_fit.pkl but no person_fit.ply",
    )
    smplh_root: Literal["model", "centred"] = Field(
        default="model",
        description="what `trans` of person_fit.pkl moves: the model as SMPL does, or the root "
        "joint itself; `hoi check-data` says which one reproduces the stored meshes",
    )
    fits_30fps: str | None = Field(
        default=None,
        description="folder of the 30 fps extension (<sequence>/smpl_fit_all.npz, "
        "object_fit_all.npz): its fits are the truth in place of the 1 fps ones; needs smplh",
    )
