"""Times the silhouette kernels against the plain reference of the same functions.

    python benchmarks/silhouette.py [--poses 64] [--repeats 9]

Prints milliseconds of process time per pose (median, one thread) and the ratio to the reference,
both measured in this run, on a generated chair of about 1000 vertices that fills most of the image.
The reference (`hoi.rendering.reference`) computes the same loss and gradient in plain numpy and
torch, the score by testing every triangle; both are slow on purpose, so the ratio says what the
kernels save and not how they compare with other people's renderers.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from hoi.exemplars.procedural import generate
from hoi.geometry import project, upright_rotations
from hoi.rendering import (
    MeshTopology,
    SilhouetteTarget,
    pose_silhouette_iou,
    pose_silhouette_loss,
    reference,
    silhouette_iou,
    silhouette_loss,
    warm_up,
)


def milliseconds(run: Callable[[], object], per: int, repeats: int) -> float:
    """Median process time of one call, divided by `per`, after one call that does not count."""
    run()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return statistics.median(times) / per * 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=64)
    parser.add_argument("--repeats", type=int, default=9)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    warm_up()

    chair = generate("chair", 7)
    topology = MeshTopology.from_faces(chair.faces, len(chair.vertices))
    vertices = torch.from_numpy(chair.vertices)
    rotations = upright_rotations(arguments.poses, torch.Generator().manual_seed(0))
    shift = torch.tensor([0.0, 0.0, 2.4]).repeat(arguments.poses, 1)
    print(
        f"{len(chair.vertices)} vertices, {len(chair.faces)} faces, {len(topology.edges)} edges, "
        f"{arguments.poses} poses; ms per pose"
    )
    print(
        f"{'px':>4} {'loss+grad':>10} {'reference':>10} {'ratio':>7}  {'score':>6} "
        f"{'reference':>10} {'ratio':>7}  {'pose loss+grad':>14} {'pose score':>10}"
    )
    for size in (64, 128, 256):
        camera = np.array([[1.8 * size, 0, size / 2], [0, 1.8 * size, size / 2], [0, 0, 1]])
        placed = vertices @ rotations.transpose(1, 2) + shift[:, None]
        xy = project(placed, camera).contiguous()
        mask = reference.coverage(xy[0].numpy(), chair.faces, size, size, 4)
        target = SilhouetteTarget(mask)
        points = xy.clone().requires_grad_()
        turns, moves = rotations.clone().requires_grad_(), shift.clone().requires_grad_()
        exact = xy[1:2].double().requires_grad_()

        def loss(points=points, target=target):
            silhouette_loss(points, topology, target, 1.0, 0.3)[0].sum().backward()

        def pose_loss(turns=turns, moves=moves, camera=camera, target=target):
            result = pose_silhouette_loss(
                vertices, turns, moves, camera, topology, target, 1.0, 0.3
            )
            result[0].sum().backward()

        def score(xy=xy, target=target):
            silhouette_iou(xy, topology, target)

        def pose_score(camera=camera, target=target):
            pose_silhouette_iou(vertices, rotations, shift, camera, topology, target)

        def slow_loss(exact=exact, target=target):
            silhouette_loss(exact, topology, target, 1.0, 0.3, "reference")[0].sum().backward()

        def slow_score(exact=exact, mask=target.mask, size=size):
            covered = reference.covered(exact[0].detach().numpy(), chair.faces, size, size)
            return (covered * mask).sum() / np.maximum(covered, mask).sum()

        count, repeats = arguments.poses, arguments.repeats
        fast, fast_score = milliseconds(loss, count, repeats), milliseconds(score, count, repeats)
        slow, slow_by = milliseconds(slow_loss, 1, 3), milliseconds(slow_score, 1, 3)
        print(
            f"{size:4} {fast:10.3f} {slow:10.1f} {slow / fast:6.0f}x  {fast_score:6.3f} "
            f"{slow_by:10.1f} {slow_by / fast_score:6.0f}x  "
            f"{milliseconds(pose_loss, count, repeats):14.3f} "
            f"{milliseconds(pose_score, count, repeats):10.3f}"
        )


if __name__ == "__main__":
    main()
