"""The benchmarks: tables that say where they come from, peers that do what they claim."""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from hoi.rendering import MeshTopology, SilhouetteTarget, reference, silhouette_loss

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))
import measure
import peers

SQUARE = torch.tensor([[[12.3, 10.2], [28.1, 10.2], [28.1, 26.4], [12.3, 26.4]]])
TWO = MeshTopology.from_faces(np.array([[0, 1, 2], [0, 2, 3]]), 4)
SIZE = 40


def test_tables_say_on_what_machine_and_code_they_were_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(measure, "RESULTS", tmp_path)
    path = measure.write_csv("speed", [{"what": "a", "ms": 1.5}, {"what": "b", "ms": 2.5}])
    with open(path, newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["ms"] for row in rows] == ["1.5", "2.5"]
    assert all(row["processor"] and row["commit"] and float(row["load"]) >= 0 for row in rows)
    assert int(rows[0]["cores"]) >= 1
    assert f"torch {torch.__version__}".split("+")[0] in rows[0]["versions"]


def test_the_soft_rasteriser_draws_the_mesh():
    wanted = reference.coverage(SQUARE[0].numpy(), TWO.faces, SIZE, SIZE)
    faces, everything = torch.from_numpy(TWO.faces).long(), slice(0, SIZE * SIZE)
    there = peers.soft_rasteriser(SQUARE[0], faces, torch.from_numpy(wanted), everything, 0.05)
    empty = peers.soft_rasteriser(SQUARE[0] + 200, faces, torch.from_numpy(wanted), everything)
    assert there < 0.05 * empty
    assert empty.item() == pytest.approx((wanted**2).sum(), rel=1e-3)


def test_the_nmr_gradient_moves_the_outline_the_right_way():
    covered = reference.covered(SQUARE[0].numpy(), TWO.faces, SIZE, SIZE)
    target = SilhouetteTarget(covered)
    for away in ([3.0, 0.0], [-3.0, 0.0], [0.0, 3.0], [0.0, -3.0]):
        moved = (SQUARE + torch.tensor(away)).requires_grad_()
        silhouette_loss(moved, TWO, target)[0].sum().backward()
        exact = moved.grad[0].sum(0).numpy()
        rough = peers.nmr_gradient(moved.detach(), TWO, target)[0].sum(0)
        assert exact @ away > 0  # further away costs more
        assert rough @ away > 0.9 * 3 * np.linalg.norm(rough) > 0


def test_without_pytorch3d_the_benchmark_says_so():
    if "pytorch3d" in sys.modules or peers.PyTorch3D.find(None)[0] is not None:
        pytest.skip("pytorch3d is installed")
    found, why = peers.PyTorch3D.find(None)
    assert found is None and "--pytorch3d" in why
