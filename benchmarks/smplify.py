"""What one iteration of the body fit costs: keypoints alone against all vertices.

    python benchmarks/smplify.py

Three ways to get the keypoints of B bodies and their derivative by all parameters:

- all vertices: skin the whole body, regress the keypoints, back-propagate (SMPLify as published);
- keypoints alone: forward kinematics and a few vertices of skin, back-propagate;
- closed form: forward kinematics and the full derivative (21 x 3 x 82) without back-propagation,
  which is what a Levenberg-Marquardt step needs. Back-propagation gives one gradient only.

Measured on one thread of a 2-core virtual machine that other jobs loaded, torch 2.13 CPU,
milliseconds of CPU time per iteration:

    B =   1  all vertices   6.92 ( 1.0x)   keypoints alone   4.01 ( 1.7x)   closed form   2.41
    B =   8  all vertices  17.75 ( 1.0x)   keypoints alone   3.70 ( 4.8x)   closed form   2.90
    B =  64  all vertices 136.49 ( 1.0x)   keypoints alone   6.87 (19.9x)   closed form   6.52

The embedded body has no pose blend shapes; real SMPL's make the first column dearer.
"""

import time
from collections.abc import Callable

import torch

from hoi.body import DEFAULT_BODY, BodyModel
from hoi.body.jacobian import KeypointKinematics
from hoi.body.keypoints import KEYPOINTS, SURFACE_KEYPOINTS
from hoi.body.skeleton import JOINT
from hoi.geometry import axis_angle_to_matrix


def milliseconds(function: Callable[[], object], repeats: int) -> float:
    """Median CPU time of a call."""
    function()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        times.append(1e3 * (time.process_time() - start))
    return sorted(times)[len(times) // 2]


def by_all_vertices(model: BodyModel, parameters: list[torch.Tensor]) -> torch.Tensor:
    """Keypoints (B, 21, 3) regressed from the skinned body."""
    vertices, joints = model(*parameters)
    on_skin = torch.zeros(len(SURFACE_KEYPOINTS), model.num_vertices)
    on_skin[:, torch.arange(len(SURFACE_KEYPOINTS))] = 1.0
    surface = dict(zip(SURFACE_KEYPOINTS, (on_skin @ vertices).unbind(1), strict=True))
    return torch.stack(
        [surface[k] if k in surface else joints[:, JOINT[k]] for k in KEYPOINTS], dim=1
    )


def compare(batch: int) -> None:
    model = BodyModel.load(DEFAULT_BODY)
    precise = BodyModel.load(DEFAULT_BODY, dtype=torch.float64)
    kinematics = KeypointKinematics(precise)
    generator = torch.Generator().manual_seed(0)
    parameters = [
        (torch.randn(batch, n, generator=generator) * 0.3).requires_grad_() for n in (3, 69, 10, 3)
    ]
    root = axis_angle_to_matrix(parameters[0]).detach().double()
    pose, betas = (p.detach().double() for p in parameters[1:3])
    times = {
        "all vertices": milliseconds(
            lambda: by_all_vertices(model, parameters).square().sum().backward(), 15
        ),
        "keypoints alone": milliseconds(
            lambda: model.keypoints(*parameters).square().sum().backward(), 40
        ),
        "closed form": milliseconds(lambda: kinematics(root, pose, betas), 40),
    }
    whole = times["all vertices"]
    print(
        f"B = {batch:3d}  "
        + "   ".join(
            f"{name} {value:6.2f} ({whole / value:4.1f}x)" for name, value in times.items()
        )
    )


if __name__ == "__main__":
    torch.set_num_threads(1)
    for size in (1, 8, 64):
        compare(size)
