"""What the joint stage takes from a frame's artifacts, checked once at the door."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from hoi.artifacts import BodyFit, Detection, Extents, Frame, ObjectFit, Prior
from hoi.errors import FrameFailure
from hoi.geometry import model_intrinsics, shift_between_cameras
from hoi.rendering import Roi
from hoi.settings import CameraModel


@dataclass(frozen=True)
class Inputs:
    """Plain arrays of one frame: camera, masks, fitted body, object poses and size prior.

    Attributes:
        intrinsics: (3, 3) of the camera the method believes in.
        object_mask, person_mask: (H, W) bool.
        body_vertices: (V, 3), body_joints: (24, 3), camera frame, metres.
        exemplars: K names; rotations: (K, 3, 3), translations: (K, 3) at library size, best first.
        roi: square region around the object.
        category: noun whose library and contact rules apply.
        given_contacts: (V,) contact probability per body vertex from another system, or None.
        size: metres of the extent that `size_axis` (longest, height) names.
        extents: ranges of height, width and depth, where the prior has them.
    """

    intrinsics: np.ndarray
    object_mask: np.ndarray
    person_mask: np.ndarray
    body_vertices: np.ndarray
    body_joints: np.ndarray
    exemplars: tuple[str, ...]
    rotations: np.ndarray
    translations: np.ndarray
    roi: Roi
    category: str
    size: float
    size_axis: str
    given_contacts: np.ndarray | None = None
    extents: Extents | None = None

    @classmethod
    def gather(
        cls,
        frame: Frame,
        detection: Detection,
        body: BodyFit,
        objects: ObjectFit,
        prior: Prior,
        roi_margin: float,
        camera: CameraModel = "photo",
    ) -> Self:
        """Raises FrameFailure when masks and photo differ in size or nothing can be optimised."""
        assert frame.image is not None and frame.intrinsics is not None
        assert detection.object_mask is not None and detection.person_mask is not None
        assert body.vertices is not None and body.joints is not None
        assert objects.rotations is not None and objects.translations is not None
        assert objects.exemplars is not None and prior.size_m is not None
        photo = frame.image.shape[:2]
        for name, mask in (("object", detection.object_mask), ("person", detection.person_mask)):
            if mask.shape != photo:
                raise FrameFailure(
                    "mask_size_mismatch", f"the {name} mask is {mask.shape}, the photo {photo}"
                )
        if not objects.exemplars:
            raise FrameFailure("no_object_pose", "the object fit holds no pose to start from")
        height, width = photo
        intrinsics = model_intrinsics(frame.intrinsics, height, width, camera)
        vertices, joints = body.vertices, body.joints
        if camera != "photo":
            moved = shift_between_cameras(vertices, frame.intrinsics, intrinsics)
            vertices, joints = (vertices + moved).astype(np.float32), joints + moved
        return cls(
            intrinsics=intrinsics,
            object_mask=detection.object_mask,
            person_mask=detection.person_mask,
            body_vertices=vertices,
            body_joints=joints,
            exemplars=tuple(objects.exemplars),
            rotations=objects.rotations,
            translations=objects.translations,
            roi=_roi(objects, detection.object_mask, roi_margin),
            category=objects.category or prior.category or frame.category,
            size=float(prior.size_m),
            size_axis=prior.size_axis,
            given_contacts=frame.given_contacts,
            extents=prior.extents,
        )


def _roi(objects: ObjectFit, mask: np.ndarray, margin: float) -> Roi:
    if objects.roi is not None:
        return Roi(*(float(value) for value in objects.roi))
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        raise FrameFailure("empty_object_mask", "the object mask has no pixel")
    box = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], float)
    return Roi.around(box, margin)
