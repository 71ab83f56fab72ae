"""Metric 3D scenes of a reconstruction: GLB (glTF 2.0), OBJ and PLY.

A scene is y-up as glTF asks: metres, +y against gravity, +z towards the photographer, the ground
at y = 0 and the origin on the ground below the body. Every file names its nodes ``body``,
``object``, ``ground`` and ``camera``. The extras of a GLB hold ``camera_from_scene``, which takes
scene points back to the OpenCV camera frame in which the stages work.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hoi.artifacts import GroundTruth, Interaction, Joint, Prior
from hoi.report.colours import blend, linear_from_srgb, rgb
from hoi.report.config import ReportConfig
from hoi.report.raycast import distance_to_surface

CAMERA_UP = np.array([0.0, -1.0, 0.0])
_STEEPEST = np.radians(40.0)  # photos are not tilted more; an object that seems so does not stand


@dataclass(frozen=True)
class Reconstruction:
    """Two meshes in the camera frame (OpenCV axes, metres) and what is known of their world.

    Attributes:
        body_vertices, body_faces: the person.
        object_vertices, object_faces: the object.
        up: (3,) direction against gravity in the camera frame.
        ground_height: height of the ground along `up`; None takes the lowest point of the scene.
    """

    body_vertices: np.ndarray
    body_faces: np.ndarray
    object_vertices: np.ndarray
    object_faces: np.ndarray
    up: np.ndarray
    ground_height: float | None = None


def followed(joint: Joint | None, prior: Prior | None) -> Interaction | None:
    """What the prior says of the action that the result follows, which need not be the retrieved.

    The retrieved action's where there is no result, or where the prior knows no such action.
    """
    if prior is None or not prior.ok:
        return None
    known = (prior.retrieved, *prior.hypotheses, prior.default, prior.true)
    used = joint.action if joint is not None and joint.ok else ""
    same = (said for said in known if said is not None and said.action == used)
    return next(same, prior.retrieved)


def gravity_up(joint: Joint | None, prior: Prior | None) -> np.ndarray:
    """(3,) unit direction against gravity in the camera frame, as well as a scene tells it.

    An object that stands on the floor points up by its own axis; else the camera is taken as level.
    """
    said = followed(joint, prior)
    stands = said is not None and said.stands_on_floor
    if joint is None or not joint.ok or joint.object_rotation is None or not stands:
        return CAMERA_UP
    up = np.asarray(joint.object_rotation, float)[:, 1]
    up = up / np.linalg.norm(up)
    return up if up @ CAMERA_UP > np.cos(_STEEPEST) else CAMERA_UP


def of_joint(joint: Joint, body_faces: np.ndarray, up: np.ndarray = CAMERA_UP) -> Reconstruction:
    """The reconstruction of a joint result. Raises ValueError when its status is not ok."""
    if not joint.ok or joint.body_vertices is None or joint.object_vertices is None:
        raise ValueError(f"frame {joint.frame_id} has no scene: {joint.status}")
    assert joint.object_faces is not None
    return Reconstruction(
        joint.body_vertices, body_faces, joint.object_vertices, joint.object_faces, up
    )


def of_truth(truth: GroundTruth, up: np.ndarray = CAMERA_UP) -> Reconstruction:
    """The true scene of a frame. Raises ValueError when the data set has none."""
    if not truth.ok or truth.body_vertices is None or truth.object_vertices is None:
        raise ValueError(f"frame {truth.frame_id} has no true scene: {truth.status}")
    assert truth.body_faces is not None and truth.object_faces is not None
    return Reconstruction(
        truth.body_vertices, truth.body_faces, truth.object_vertices, truth.object_faces, up
    )


def scene_from_camera(reconstruction: Reconstruction) -> np.ndarray:
    """The rigid transform (4, 4) from camera axes (y down, z forward) to the y-up scene."""
    up = np.asarray(reconstruction.up, float)
    up = up / np.linalg.norm(up)
    # glTF cameras look along -z: keep the photo's viewing direction there, made level.
    backward = -np.array([0.0, 0.0, 1.0])
    backward = backward - (backward @ up) * up
    if np.linalg.norm(backward) < 1e-6:
        raise ValueError("the camera looks straight along gravity; a level direction is needed")
    backward /= np.linalg.norm(backward)
    rotation = np.stack([np.cross(up, backward), up, backward])
    body = reconstruction.body_vertices @ rotation.T
    ground = reconstruction.ground_height
    if ground is None:
        ground = min(body[:, 1].min(), (reconstruction.object_vertices @ rotation.T)[:, 1].min())
    middle = (body.min(axis=0) + body.max(axis=0)) / 2
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = -middle[0], -ground, -middle[2]
    return transform


def contact_weights(
    reconstruction: Reconstruction, config: ReportConfig
) -> tuple[np.ndarray, np.ndarray]:
    """How close each body vertex is to the object.

    Returns:
        weight (V,): 1 up to `contact_near_m`, falling linearly to 0 at `contact_far_m`.
        distance (V,): to the object's surface, metres.
    """
    distance = distance_to_surface(
        reconstruction.body_vertices, reconstruction.object_vertices, reconstruction.object_faces
    )
    span = max(config.contact_far_m - config.contact_near_m, 1e-9)
    return np.clip((config.contact_far_m - distance) / span, 0.0, 1.0), distance


def body_colours(reconstruction: Reconstruction, config: ReportConfig) -> np.ndarray:
    """sRGB colours (V, 3) in 0..255 of the body, reddened where it touches the object."""
    weight, _ = contact_weights(reconstruction, config)
    return blend(
        np.array(rgb(config.contact_colour), float),
        np.array(rgb(config.body_colour), float),
        weight,
    )


def scene_glb(
    reconstruction: Reconstruction,
    config: ReportConfig | None = None,
    *,
    intrinsics: np.ndarray | None = None,
    image_size: tuple[int, int] | None = None,
    description: str = "",
    compact: bool = False,
) -> bytes:
    """A GLB file of the scene; equal inputs give equal bytes.

    Args:
        reconstruction: meshes in the camera frame.
        config: colours and sizes.
        intrinsics: (3, 3) K; with `image_size` (width, height) it gives the camera's field of
            view. glTF knows no principal point, so a photo's off-centre one is not kept.
        description: free text for the file's extras, e.g. the frame's name.
        compact: round vertices to `scene_precision_m` and leave normals out, for web pages.
    """
    import trimesh
    from trimesh.exchange.gltf import export_glb

    config = config or ReportConfig()
    transform = scene_from_camera(reconstruction)
    scene = trimesh.Scene(
        metadata={
            "description": description,
            "units": "metres",
            "camera_from_scene": (np.linalg.inv(transform).round(9) + 0.0).tolist(),
        }
    )
    precision = config.scene_precision_m if compact else None
    body = _mesh(
        reconstruction.body_vertices,
        reconstruction.body_faces,
        transform,
        body_colours(reconstruction, config),
        precision,
    )
    if not compact:
        _ = body.vertex_normals  # trimesh writes the normals that a mesh has already computed
    thing = _mesh(
        reconstruction.object_vertices,
        reconstruction.object_faces,
        transform,
        np.array(rgb(config.object_colour), float),
        precision,
    )
    for name, mesh in (("body", body), ("object", thing), ("ground", _ground(config))):
        scene.add_geometry(mesh, node_name=name, geom_name=name)

    camera = np.eye(4)
    camera[:3, :3] = transform[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    camera[:3, 3] = transform[:3, 3]

    def finish(tree: dict) -> None:
        tree["asset"]["generator"] = "hoi"
        tree["materials"] = [
            {
                "name": "matte",
                "doubleSided": True,
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.9},
            }
        ]
        for mesh in tree["meshes"]:
            for primitive in mesh["primitives"]:
                primitive["material"] = 0
        _add_camera(tree, camera, _field_of_view(intrinsics, image_size))

    return export_glb(scene, tree_postprocessor=finish)


def write_scene_glb(
    path: Path | str,
    joint: Joint,
    body_faces: np.ndarray,
    config: ReportConfig | None = None,
    *,
    intrinsics: np.ndarray | None = None,
    image_size: tuple[int, int] | None = None,
    up: np.ndarray = CAMERA_UP,
) -> None:
    """Write the scene of a joint result as GLB, see :func:`scene_glb`.

    Raises ValueError when the joint result's status is not ok.
    """
    data = scene_glb(
        of_joint(joint, body_faces, up),
        config,
        intrinsics=intrinsics,
        image_size=image_size,
        description=f"{joint.frame_id} {joint.method}".strip(),
    )
    _write(path, data)


def write_scene_meshes(
    path: Path | str, joint: Joint, body_faces: np.ndarray, up: np.ndarray = CAMERA_UP
) -> None:
    """Write body and object of a joint result as one OBJ or PLY file, chosen by `path`'s suffix.

    The axes are those of the GLB. An OBJ keeps ``o body`` and ``o object`` apart; a PLY is one
    mesh. Raises ValueError for another suffix or when the status is not ok.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in {".obj", ".ply"}:
        raise ValueError(f"{path}: expected a name that ends in .obj or .ply")
    reconstruction = of_joint(joint, body_faces, up)
    transform = scene_from_camera(reconstruction)
    parts = {
        "body": (_move(reconstruction.body_vertices, transform), reconstruction.body_faces),
        "object": (_move(reconstruction.object_vertices, transform), reconstruction.object_faces),
    }
    _write(path, _obj(parts).encode() if suffix == ".obj" else _ply(parts))


def _write(path: Path | str, data: bytes) -> None:
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_bytes(data)


def _move(points: np.ndarray, transform: np.ndarray) -> np.ndarray:
    return points @ transform[:3, :3].T + transform[:3, 3]


def _mesh(vertices, faces, transform, colours, precision):
    import trimesh

    moved = _move(np.asarray(vertices, float), transform)
    if precision is not None:
        moved = np.round(moved / precision) * precision
    linear = np.round(255.0 * linear_from_srgb(np.asarray(colours, float) / 255.0))
    rgba = np.full((len(moved), 4), 255, np.uint8)
    rgba[:, :3] = linear
    return trimesh.Trimesh(moved, faces, vertex_colors=rgba, process=False)


def _ground(config: ReportConfig):
    import trimesh

    half = config.ground_size_m / 2
    corners = np.array([[-half, 0, -half], [-half, 0, half], [half, 0, half], [half, 0, -half]])
    linear = np.round(255.0 * linear_from_srgb(np.array(rgb(config.ground_colour)) / 255.0))
    rgba = np.tile(np.append(linear, 255).astype(np.uint8), (4, 1))
    faces = [[0, 1, 2], [0, 2, 3]]
    return trimesh.Trimesh(corners, faces, vertex_colors=rgba, process=False)


def _field_of_view(
    intrinsics: np.ndarray | None, image_size: tuple[int, int] | None
) -> tuple[float, float]:
    """Vertical field of view (radians) and aspect ratio; 60 degrees and 4:3 when unknown."""
    if intrinsics is None or image_size is None:
        return float(np.radians(60.0)), 4 / 3
    width, height = image_size
    vertical = 2.0 * np.arctan(height / (2.0 * intrinsics[1, 1]))
    return float(vertical), float(width * intrinsics[1, 1] / (height * intrinsics[0, 0]))


def _add_camera(tree: dict, pose: np.ndarray, view: tuple[float, float]) -> None:
    perspective = {"yfov": view[0], "aspectRatio": view[1], "znear": 0.05}
    tree["cameras"] = [{"name": "camera", "type": "perspective", "perspective": perspective}]
    tree["nodes"].append({"name": "camera", "camera": 0, "matrix": pose.T.ravel().tolist()})
    tree["scenes"][tree["scene"]]["nodes"].append(len(tree["nodes"]) - 1)


def _obj(parts: dict[str, tuple[np.ndarray, np.ndarray]]) -> str:
    """OBJ text: metres with five decimals, one object a part."""
    text, offset = io.StringIO(), 1
    text.write("# hoi scene, metres, y up\n")
    for name, (vertices, faces) in parts.items():
        text.write(f"o {name}\n")
        np.savetxt(text, vertices, fmt="v %.5f %.5f %.5f")
        np.savetxt(text, faces + offset, fmt="f %d %d %d")
        offset += len(vertices)
    return text.getvalue()


def _ply(parts: dict[str, tuple[np.ndarray, np.ndarray]]) -> bytes:
    import trimesh
    from trimesh.exchange.ply import export_ply

    meshes = [trimesh.Trimesh(v, f, process=False) for v, f in parts.values()]
    return export_ply(trimesh.util.concatenate(meshes))
