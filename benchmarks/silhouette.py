"""Silhouette loss with gradient: this project's back ends and other people's, in one run.

    python benchmarks/silhouette.py [--sizes 64,128,256] [--pytorch3d CHECKOUT] [--quick]

CPU milliseconds per mesh of one thread (median) for sum (S - M)^2 and its derivative by all
vertices, on a generated chair of about 1000 vertices that fills most of the image; on a CUDA device
also the torch back end there (wall time). Writes ``results/silhouette.csv``. PyTorch3D is used
when installed; ``--pytorch3d`` compiles its CPU rasteriser from a clone. Where neither is there its
rows say so. SoftRas is measured on a part of the pixels and extrapolated, as it is linear in them.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import milliseconds, rounded, show, write_csv
from peers import PyTorch3D, nmr_gradient, soft_rasteriser

from hoi.exemplars.procedural import generate
from hoi.geometry import project, upright_rotations
from hoi.rendering import (
    MeshTopology,
    SilhouetteTarget,
    pose_silhouette_iou,
    pose_silhouette_loss,
    render_silhouette,
    silhouette_iou,
    silhouette_loss,
    warm_up,
)

DEPTH = 2.4
EDGE_WEIGHT = 0.3


class Scene:
    """B poses of one chair at one image size, and a mask to compare them with."""

    def __init__(self, size: int, poses: int):
        chair = generate("chair", 7)
        self.size = size
        self.topology = MeshTopology.from_faces(chair.faces, len(chair.vertices))
        self.vertices = torch.from_numpy(chair.vertices)
        self.rotations = upright_rotations(poses, torch.Generator().manual_seed(0))
        self.shift = torch.tensor([0.0, 0.0, DEPTH]).repeat(poses, 1)
        self.camera = np.array([[1.8 * size, 0, size / 2], [0, 1.8 * size, size / 2], [0, 0, 1]])
        placed = self.vertices @ self.rotations.transpose(1, 2) + self.shift[:, None]
        self.xy = project(placed, self.camera).contiguous()
        mask = render_silhouette(self.xy[:1], self.topology, size, size)[0].numpy()
        self.target = SilhouetteTarget(mask)

    def loss(self, xy: torch.Tensor, backend: Any = None) -> torch.Tensor:
        """Gradient by the vertices with the named back end."""
        points = xy.detach().requires_grad_()
        loss, _ = silhouette_loss(points, self.topology, self.target, 1.0, EDGE_WEIGHT, backend)
        (grad,) = torch.autograd.grad(loss.sum(), points)
        return grad

    def pose_loss(self) -> None:
        """Gradient by the placements, as the search uses it."""
        turns, moves = self.rotations.clone().requires_grad_(), self.shift.clone().requires_grad_()
        placed = (self.vertices, turns, moves, self.camera, self.topology, self.target)
        pose_silhouette_loss(*placed, 1.0, EDGE_WEIGHT)[0].sum().backward()

    def pose_score(self) -> None:
        """Overlap of the placements, without gradient."""
        pose_silhouette_iou(
            self.vertices, self.rotations, self.shift, self.camera, self.topology, self.target
        )

    def soft_rasteriser(self, pixels: int) -> None:
        """Loss and gradient of some pixels in the middle of the first image."""
        points = self.xy[0].clone().requires_grad_()
        faces = torch.from_numpy(self.topology.faces).long()
        start = (self.size // 2) * self.size
        chunk = slice(start, start + pixels)
        soft_rasteriser(points, faces, torch.from_numpy(self.target.mask), chunk).backward()


def rows_of(size: int, peer: PyTorch3D | None, why: str, quick: bool) -> list[dict[str, Any]]:
    """Measure every renderer at one size."""
    many, few, one = Scene(size, 64), Scene(size, 8), Scene(size, 1)
    rows: list[dict[str, Any]] = []

    def add(name: str, gradient: str, ms: float | None, note: str = "") -> None:
        ours = rows[0]["ms_per_mesh"] if rows else ms
        rows.append(
            {
                "renderer": name,
                "pixels": size,
                "gradient": gradient,
                "ms_per_mesh": "" if ms is None else rounded(ms),
                "times_ours": "" if ms is None else rounded(ms / ours),
                "note": note,
            }
        )
        show(rows[-1])

    def measured(run: Callable[[], object], per: int, repeats: int = 9) -> float:
        return milliseconds(run, per, repeats)

    add("hoi numba", "vertices", measured(lambda: many.loss(many.xy), 64), "batch 64, edge term on")
    add("hoi numba", "placements", measured(many.pose_loss, 64), "batch 64, projection included")
    add("hoi numba", "none", measured(many.pose_score, 64), "score of a placement")
    xy_only = measured(lambda: silhouette_iou(many.xy, many.topology, many.target), 64)
    add("hoi numba", "none", xy_only, "score of image coordinates")
    add("hoi torch", "vertices", measured(lambda: few.loss(few.xy, "torch"), 8, 5), "CPU, batch 8")
    if torch.cuda.is_available():
        for batch in (64, 1024):
            add(*_on_cuda(Scene(size, batch), batch))
    add("hoi reference", "vertices", measured(lambda: one.loss(one.xy, "reference"), 1, 2), "numpy")
    nmr = functools.partial(nmr_gradient, many.xy, many.topology, many.target)
    add("NMR style", "vertices", measured(nmr, 64, 3), "numba, outline edges only")
    pixels = 512 if size <= 64 else 128
    soft = measured(lambda: one.soft_rasteriser(pixels), 1, 3) * size**2 / pixels
    add("SoftRas torch", "vertices", soft, f"extrapolated from {pixels} pixels")
    if peer is None:
        add("PyTorch3D CPU", "vertices", None, f"skipped: {why}")
        return rows
    for kind in ("hard",) if quick else ("hard", "soft"):
        run = functools.partial(
            peer.loss_and_gradient, one.xy, one.topology, one.target, kind == "soft"
        )
        add(f"PyTorch3D CPU {kind}", "vertices", once(run), why)
    return rows


def once(run: Callable[[], object]) -> float:
    """CPU milliseconds of a single call, for what takes seconds."""
    start = time.process_time()
    run()
    return (time.process_time() - start) * 1e3


def _on_cuda(scene: Scene, batch: int) -> tuple[str, str, float, str]:
    points = scene.xy.cuda()
    for _ in range(2):
        scene.loss(points)
    torch.cuda.synchronize()
    start = time.perf_counter()
    for _ in range(5):
        scene.loss(points)
    torch.cuda.synchronize()
    ms = (time.perf_counter() - start) / 5 / batch * 1e3
    return "hoi torch", "vertices", ms, f"{torch.cuda.get_device_name()}, batch {batch}, wall time"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="64,128,256")
    parser.add_argument("--pytorch3d", type=Path, help="a clone of PyTorch3D, to be compiled")
    parser.add_argument("--quick", action="store_true", help="without PyTorch3D's soft silhouette")
    parser.add_argument("--csv", default="silhouette", help="name of the table")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    warm_up()
    peer, why = PyTorch3D.find(arguments.pytorch3d)
    sizes = [int(size) for size in arguments.sizes.split(",")]
    rows = [row for size in sizes for row in rows_of(size, peer, why, arguments.quick)]
    write_csv(arguments.csv, rows)


if __name__ == "__main__":
    main()
