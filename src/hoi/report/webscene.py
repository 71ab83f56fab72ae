"""All scenes of one frame as one small GLB for its page.

Methods differ in little: the same body under the same faces, often the same object. The file keeps
every array once (by content), positions as 16-bit integers (KHR_mesh_quantization), and one frame
of reference, so that methods and the truth can be laid over one another. Exports for other
programs are in :mod:`hoi.report.scene`.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence

import numpy as np

from hoi.report.colours import linear_from_srgb
from hoi.report.config import ReportConfig
from hoi.report.scene import Reconstruction, body_colours, scene_from_camera

_SHORT, _USHORT, _UBYTE, _UINT = 5122, 5123, 5121, 5125
_ARRAY, _ELEMENTS = 34962, 34963
_LARGEST = 32000  # of a 16-bit position


def web_scene(
    scenes: Sequence[tuple[str, Reconstruction]],
    config: ReportConfig,
    *,
    intrinsics: np.ndarray | None,
    image_size: tuple[int, int] | None,
    up: np.ndarray,
) -> bytes:
    """A GLB with a node per scene, named as given, each with children ``body`` and ``object``.

    Args:
        scenes: name and meshes, all in one camera's frame; the first one's floor is at y = 0.
        config: colours and the grid of positions.
        intrinsics: (3, 3) of the photo, pixels; image_size: its width and height.
        up: (3,) against gravity in the camera's frame.

    The extras hold ``scene_from_camera`` (4, 4) and ``photo``: the corners of the photo (top left,
    top right, bottom right, bottom left) in the scene, on a plane behind everything near.
    """
    first = scenes[0][1]
    transform = scene_from_camera(
        Reconstruction(
            first.body_vertices,
            first.body_faces,
            first.object_vertices,
            first.object_faces,
            up,
            first.ground_height,
        )
    )
    writer = _Writer()
    tops = []
    for name, scene in scenes:
        parts = (
            ("body", scene.body_vertices, scene.body_faces, body_colours(scene, config)),
            ("object", scene.object_vertices, scene.object_faces, None),
        )
        children = [
            writer.mesh(part, _moved(vertices, transform), faces, colours, config)
            for part, vertices, faces, colours in parts
        ]
        tops.append(writer.node({"name": name, "children": children}))
    extras = {
        "scene_from_camera": np.round(transform, 6).tolist(),
        "photo": _photo_corners([scene for _, scene in scenes], transform, intrinsics, image_size),
    }
    return writer.glb(tops, extras)


def _moved(points: np.ndarray, transform: np.ndarray) -> np.ndarray:
    return np.asarray(points, float) @ transform[:3, :3].T + transform[:3, 3]


def _photo_corners(
    scenes: Sequence[Reconstruction],
    transform: np.ndarray,
    intrinsics: np.ndarray | None,
    image_size: tuple[int, int] | None,
) -> list[list[float]]:
    if intrinsics is None or image_size is None:
        return []
    width, height = image_size
    depth = 1.25 * max(float(scene.body_vertices[:, 2].max()) for scene in scenes) + 0.5
    pixels = np.array([[0, 0], [width, 0], [width, height], [0, height]], float)
    rays = np.column_stack([pixels, np.ones(4)]) @ np.linalg.inv(intrinsics).T
    return np.round(_moved(rays * depth, transform), 4).tolist()


class _Writer:
    """Collects arrays, meshes and nodes of a GLB; equal arrays are stored once."""

    def __init__(self):
        self._binary = bytearray()
        self._views: list[dict] = []
        self._accessors: list[dict] = []
        self._known: dict[tuple, int] = {}
        self._meshes: list[dict] = []
        self._nodes: list[dict] = []

    def node(self, node: dict) -> int:
        self._nodes.append(node)
        return len(self._nodes) - 1

    def mesh(
        self,
        name: str,
        vertices: np.ndarray,
        faces: np.ndarray,
        colours: np.ndarray | None,
        config: ReportConfig,
    ) -> int:
        """A node with one mesh; positions are whole multiples of the node's scale."""
        middle = (vertices.max(axis=0) + vertices.min(axis=0)) / 2
        reach = float(np.abs(vertices - middle).max())
        step = max(config.scene_precision_m, reach / _LARGEST)
        whole = np.round((vertices - middle) / step).astype(np.int16)
        attributes = {"POSITION": self._positions(whole)}
        if colours is not None:
            linear = np.round(255 * linear_from_srgb(np.asarray(colours, float) / 255))
            rgba = np.column_stack([linear, np.full(len(linear), 255)]).astype(np.uint8)
            attributes["COLOR_0"] = self._accessor(
                rgba, _UBYTE, "VEC4", _ARRAY, {"normalized": True}
            )
        kind, code = (np.uint16, _USHORT) if len(vertices) < 65535 else (np.uint32, _UINT)
        indices = self._accessor(np.asarray(faces, kind).ravel(), code, "SCALAR", _ELEMENTS)
        self._meshes.append(
            {"name": name, "primitives": [{"attributes": attributes, "indices": indices}]}
        )
        return self.node(
            {
                "name": name,
                "mesh": len(self._meshes) - 1,
                "translation": [float(value) for value in middle],
                "scale": [step] * 3,
            }
        )

    def _positions(self, whole: np.ndarray) -> int:
        padded = np.zeros((len(whole), 4), np.int16)  # rows begin at multiples of four bytes
        padded[:, :3] = whole
        limits = {"min": whole.min(axis=0).tolist(), "max": whole.max(axis=0).tolist()}
        return self._accessor(padded, _SHORT, "VEC3", _ARRAY, limits, stride=8)

    def _accessor(
        self,
        array: np.ndarray,
        component: int,
        kind: str,
        target: int,
        more: dict | None = None,
        stride: int = 0,
    ) -> int:
        data = np.ascontiguousarray(array).tobytes()
        key = (data, component, kind)
        if key in self._known:
            return self._known[key]
        self._binary.extend(b"\0" * (-len(self._binary) % 4))
        view = {
            "buffer": 0,
            "byteOffset": len(self._binary),
            "byteLength": len(data),
            "target": target,
        }
        if stride:
            view["byteStride"] = stride
        self._views.append(view)
        self._binary.extend(data)
        self._accessors.append(
            {
                "bufferView": len(self._views) - 1,
                "componentType": component,
                "count": len(array),
                "type": kind,
                **(more or {}),
            }
        )
        self._known[key] = len(self._accessors) - 1
        return self._known[key]

    def glb(self, tops: list[int], extras: dict) -> bytes:
        """The file: header, JSON chunk, binary chunk."""
        self._binary.extend(b"\0" * (-len(self._binary) % 4))
        tree = {
            "asset": {"version": "2.0", "generator": "hoi"},
            "extensionsUsed": ["KHR_mesh_quantization"],
            "extensionsRequired": ["KHR_mesh_quantization"],
            "scene": 0,
            "scenes": [{"nodes": tops, "extras": extras}],
            "nodes": self._nodes,
            "meshes": self._meshes,
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._binary)}],
        }
        text = json.dumps(tree, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + len(self._binary)
        return (
            struct.pack("<4sII", b"glTF", 2, total)
            + struct.pack("<I4s", len(text), b"JSON")
            + text
            + struct.pack("<I4s", len(self._binary), b"BIN\0")
            + bytes(self._binary)
        )
