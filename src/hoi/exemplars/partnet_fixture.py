"""Generated shapes in PartNet's own layout: for tests and benchmarks, never for results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from hoi.exemplars.library import Exemplar
from hoi.exemplars.vocabulary import PARTNET_CATEGORY


def write_shape(
    root: Path | str,
    anno_id: str,
    exemplar: Exemplar,
    points: int = 0,
    pieces_folder: str = "objs",
    kind: str = "",
) -> Path:
    """Write one exemplar as the folder ``<root>/<anno_id>`` of PartNet v0; returns it.

    Every part becomes ``<object>/<part>/<part>_surface/<part>_piece`` in ``result.json``; the last
    level is merged away in ``result_after_merging.json``, whose ids start at 1000 so that nobody
    can take them for those of ``result.json``. The shape is scaled into the unit sphere.

    Args:
        points: sampled points with labels, 0 writes none, as many Mobility shapes have none.
        pieces_folder: ``textured_objs`` writes it as PartNet-Mobility does.
        kind: name of a level right below the object, e.g. ``luggage``.
    """
    folder = Path(root) / anno_id
    (folder / pieces_folder).mkdir(parents=True, exist_ok=True)
    vertices = exemplar.vertices / np.linalg.norm(exemplar.vertices, axis=1).max()
    category = PARTNET_CATEGORY.get(exemplar.category, exemplar.category.capitalize())
    raw: dict[str, Any] = _node(category.lower(), 0)
    final: dict[str, Any] = _node(category.lower(), 1000, 0)
    raw_parent, final_parent = raw, final
    number = 1
    if kind:
        raw_parent, final_parent = _node(kind, 1), _node(kind, 1001, 1)
        raw["children"], final["children"] = [raw_parent], [final_parent]
        number = 2
    raw_parent["children"], final_parent["children"] = [], []
    leaf_of_part = []
    for index, part in enumerate(exemplar.part_names):
        piece = f"new-{index}"
        leaf = _node(f"{part}_piece", number + 2) | {"objs": [piece]}
        surface = _node(f"{part}_surface", number + 1) | {"children": [leaf]}
        raw_parent["children"].append(_node(part, number) | {"children": [surface]})
        merged = _node(f"{part}_surface", 1000 + number + 1, number + 1) | {"objs": [piece]}
        final_parent["children"].append(
            _node(part, 1000 + number, number) | {"objs": [piece], "children": [merged]}
        )
        leaf_of_part.append(number + 2)
        number += 3
        _write_obj(folder / pieces_folder / f"{piece}.obj", vertices, exemplar, index)
    _write_json(folder / "result.json", [raw])
    _write_json(folder / "result_after_merging.json", [final])
    meta = {"model_id": f"generated{anno_id}", "anno_id": anno_id, "version": "1"}
    _write_json(folder / "meta.json", meta | {"model_cat": category})
    if points:
        _write_points(folder / "point_sample", vertices, exemplar, np.array(leaf_of_part), points)
    return folder


def _node(name: str, number: int, origin: int | None = None) -> dict[str, Any]:
    node = {"text": name.replace("_", " ").title(), "name": name, "id": number}
    return node if origin is None else node | {"ori_id": origin}


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content), encoding="utf-8")


def _write_obj(path: Path, vertices: np.ndarray, exemplar: Exemplar, part: int) -> None:
    faces = exemplar.faces[exemplar.face_parts == part]
    used, corners = np.unique(faces, return_inverse=True)
    lines = ["v {:.6f} {:.6f} {:.6f}".format(*vertex) for vertex in vertices[used]]
    lines += ["f {} {} {}".format(*face) for face in corners.reshape(-1, 3) + 1]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_points(
    folder: Path, vertices: np.ndarray, exemplar: Exemplar, leaves: np.ndarray, count: int
) -> None:
    rng = np.random.default_rng(0)
    triangles = vertices.astype(np.float64)[exemplar.faces]
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(cross, axis=1)
    chosen = rng.choice(len(area), count, p=area / area.sum())
    shares = rng.dirichlet(np.ones(3), count)
    points = np.einsum("nk,nkd->nd", shares, triangles[chosen])
    labels = leaves[exemplar.face_parts[chosen]]
    folder.mkdir(exist_ok=True)
    table = np.hstack([points, cross[chosen] / area[chosen, None], np.full((count, 4), 1.0)])
    np.savetxt(folder / "sample-points-all-pts-nor-rgba-10000.txt", table, "%.6f")
    np.savetxt(folder / "sample-points-all-label-10000.txt", labels, "%d")
    np.savetxt(folder / "pts-10000.txt", points, "%.6f")
    np.savetxt(folder / "label-10000.txt", labels, "%d")
