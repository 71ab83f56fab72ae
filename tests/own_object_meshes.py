"""Meshes that nobody has a generator for, written as a user would have them: files."""

from pathlib import Path

import numpy as np
import trimesh

from hoi.exemplars.solids import ball, box, disc, ellipsoid, rod, tube, union


def as_trimesh(solids) -> trimesh.Trimesh:
    mesh = union(solids).to_mesh()
    points = np.asarray(mesh.vert_properties)[:, :3]
    return trimesh.Trimesh(points, np.asarray(mesh.tri_verts), process=False)


def stroller() -> dict[str, trimesh.Trimesh]:
    """Part -> mesh of a pushchair in metres, y up, front +z: 1.05 m high at the handle."""
    wheels = [disc(0.11, 0.05).rotate((0, 0, 90)).translate((sx * 0.24, 0.11, z))
              for sx in (-1, 1) for z in (-0.32, 0.36)]  # fmt: skip
    frame = [rod((sx * 0.22, 0.12, 0.36), (sx * 0.22, 0.98, -0.42), 0.018) for sx in (-1, 1)]
    frame += [rod((sx * 0.22, 0.12, -0.32), (sx * 0.22, 0.55, 0.05), 0.018) for sx in (-1, 1)]
    frame += [rod((-0.24, 0.11, z), (0.24, 0.11, z), 0.014) for z in (-0.32, 0.36)]
    handle = [rod((-0.25, 1.03, -0.47), (0.25, 1.03, -0.47), 0.022)]
    handle += [rod((sx * 0.22, 0.95, -0.39), (sx * 0.22, 1.03, -0.47), 0.02) for sx in (-1, 1)]
    seat = [box((0.4, 0.06, 0.34), (0, 0.45, 0.12)), box((0.4, 0.5, 0.06), (0, 0.66, -0.1), 0.35)]
    seat += [ellipsoid((0.4, 0.2, 0.4), (0, 0.92, -0.06))]
    parts = {"wheel": wheels, "frame": frame, "handle": handle, "seat": seat}
    return {name: as_trimesh(solids) for name, solids in parts.items()}


def umbrella() -> dict[str, trimesh.Trimesh]:
    """Part -> mesh of an open umbrella in metres, y up: the canopy is an open sheet."""
    dome = trimesh.creation.icosphere(3, radius=0.62)
    dome.update_faces(dome.triangles_center[:, 1] > 0.30)
    dome.remove_unreferenced_vertices()
    dome.apply_translation((0, 0.28, 0))
    handle = [tube([(0, 0.16, 0), (0, 0.06, 0), (0, 0.0, 0.04), (0, 0.05, 0.08)], 0.014)]
    shaft = [rod((0, 0.15, 0), (0, 0.94, 0), 0.007), ball(0.015, (0, 0.94, 0))]
    return {"canopy": dome, "shaft": as_trimesh(shaft), "handle": as_trimesh(handle)}


def write_glb(parts: dict[str, trimesh.Trimesh], path: Path, turn=None, scale=1.0) -> Path:
    """One node a part, as modelling programs write it."""
    scene = trimesh.Scene()
    for name, mesh in parts.items():
        moved = mesh.copy()
        moved.apply_scale(scale)
        moved.apply_transform(np.eye(4) if turn is None else turn)
        scene.add_geometry(moved, node_name=f"{name}.001", geom_name=f"{name}_mesh")
    scene.export(path)
    return path
