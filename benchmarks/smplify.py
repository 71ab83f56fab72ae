"""What one iteration of the body fit costs: keypoints alone against all vertices.

    python benchmarks/smplify.py

Three ways to get the keypoints of B bodies and their derivative by all parameters:

- all vertices: skin the whole body, regress the keypoints, back-propagate (SMPLify as published);
- keypoints alone: forward kinematics and a few vertices of skin, back-propagate;
- closed form: forward kinematics and the full derivative (21 x 3 x 82) without back-propagation,
  which is what a Levenberg-Marquardt step needs. Back-propagation gives one gradient only.

Milliseconds of CPU time per iteration on one thread go to ``results/smplify.csv``. The embedded
body has no pose blend shapes; real SMPL's make the first column dearer.
"""

from typing import Any

import torch
from measure import milliseconds, rounded, show, write_csv

from hoi.body import DEFAULT_BODY, BodyModel
from hoi.body.jacobian import KeypointKinematics
from hoi.body.keypoints import KEYPOINTS, SURFACE_KEYPOINTS
from hoi.body.skeleton import JOINT
from hoi.geometry import axis_angle_to_matrix


def by_all_vertices(model: BodyModel, parameters: list[torch.Tensor]) -> torch.Tensor:
    """Keypoints (B, 21, 3) regressed from the skinned body."""
    vertices, joints = model(*parameters)
    on_skin = torch.zeros(len(SURFACE_KEYPOINTS), model.num_vertices)
    on_skin[:, torch.arange(len(SURFACE_KEYPOINTS))] = 1.0
    surface = dict(zip(SURFACE_KEYPOINTS, (on_skin @ vertices).unbind(1), strict=True))
    return torch.stack(
        [surface[k] if k in surface else joints[:, JOINT[k]] for k in KEYPOINTS], dim=1
    )


def compare(batch: int) -> dict[str, Any]:
    """One row."""
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
        "all_vertices_ms": milliseconds(
            lambda: by_all_vertices(model, parameters).square().sum().backward(), repeats=9
        ),
        "keypoints_ms": milliseconds(
            lambda: model.keypoints(*parameters).square().sum().backward(), repeats=20
        ),
        "closed_form_ms": milliseconds(lambda: kinematics(root, pose, betas), repeats=20),
    }
    return {"bodies": batch} | {name: rounded(value) for name, value in times.items()}


def main() -> None:
    torch.set_num_threads(1)
    rows = []
    for size in (1, 8, 64):
        rows.append(compare(size))
        show(rows[-1])
    write_csv("smplify", rows)


if __name__ == "__main__":
    main()
