"""The two ways from a raw mesh to an exemplar, side by side: closed level set, ball pivoting.

    python benchmarks/remesh.py --out benchmarks/results/remesh.csv

Raw meshes: the curated furniture of the package with its inner faces and a tenth of its triangles
gone, as downloaded meshes are (torn), and generated chairs with exact parts. Distances are means
over 4000 area-uniform samples, in millimetres, both ways; `parts` is the share of samples of the
raw surface whose part the nearest point of the exemplar agrees with.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import numpy as np

from hoi.exemplars.furniture import load_furniture
from hoi.exemplars.library import Exemplar
from hoi.exemplars.procedural import generate
from hoi.exemplars.ray_surface import RaySurface
from hoi.exemplars.remesh import is_closed, remesh

METHODS = ("watertight", "ball_pivoting")
SAMPLES = 4000


def raw_meshes(count: int) -> list[Exemplar]:
    """Torn furniture and whole generated chairs."""
    furniture = load_furniture("exemplar_pool", "chair")[:count]
    rng = np.random.default_rng(0)
    torn = []
    for item in furniture:
        kept = np.sort(rng.permutation(len(item.faces))[len(item.faces) // 10 :])
        torn.append(
            Exemplar(
                item.name, item.category, item.vertices, item.faces[kept], item.part_names,
                item.face_parts[kept],
            )
        )  # fmt: skip
    return torn + [generate("chair", seed, 3000) for seed in range(count)]


def sampled(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Area-uniform points (N, 3) and their faces (N,)."""
    rng = np.random.default_rng(1)
    triangles = vertices.astype(np.float64)[faces]
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(cross, axis=1)
    chosen = rng.choice(len(faces), SAMPLES, p=area / area.sum())
    shares = rng.dirichlet(np.ones(3), SAMPLES)
    return np.einsum("nk,nkd->nd", shares, triangles[chosen]), chosen


def measure(raw: Exemplar, method: str) -> dict[str, float]:
    """What one method makes of one mesh."""
    started = time.process_time()
    vertices, faces, nearest = remesh(raw.vertices, raw.faces, method, 1000)
    seconds = time.process_time() - started
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    there, there_faces = sampled(raw.vertices, raw.faces)
    back, _ = sampled(vertices, faces)
    made, original = RaySurface(vertices, faces), RaySurface(raw.vertices, raw.faces)
    _, hit = made.closest(there)
    agree = raw.face_parts[nearest[hit]] == raw.face_parts[there_faces]
    return {
        "cpu_seconds": seconds,
        "vertices": len(vertices),
        "closed": float(is_closed(vertices, faces)),
        "boundary_edges": int((uses == 1).sum()),
        "non_manifold_edges": int((uses > 2).sum()),
        "raw_to_mesh_mm": 1000 * float(made.distances(there).mean()),
        "mesh_to_raw_mm": 1000 * float(original.distances(back).mean()),
        "raw_to_mesh_worst_mm": 1000 * float(made.distances(there).max()),
        "parts": float(agree.mean()),
    }


def main() -> None:
    """Measure both methods and write the means."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--count", type=int, default=10, help="meshes of each kind")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    meshes = raw_meshes(options.count)
    remesh(meshes[0].vertices, meshes[0].faces, "watertight", 300)  # libraries are loaded
    rows = []
    for method in METHODS:
        results = [measure(mesh, method) for mesh in meshes]
        means = {key: np.mean([r[key] for r in results]) for key in results[0]}
        rows.append(
            {"method": method, "meshes": len(meshes)} | {k: f"{v:.3g}" for k, v in means.items()}
        )
    for row in rows:
        print(row)
    if options.out:
        with options.out.open("w", newline="") as stream:
            writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
