"""The typed, validated artifacts in which the stages meet.

One artifact is one ``.npz`` file: every array field is an entry, everything else sits in one JSON
entry named ``meta``. Nothing is pickled, so a file cannot run code, and equal content gives equal
bytes, so the sha256 of the file identifies the artifact.

Conventions: metres, radians, pixels; camera frame with OpenCV axes (x right, y down, z forward);
image coordinates in which the pixel in column ``c`` and row ``r`` covers ``[c, c+1) x [r, r+1)``.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeAlias

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator

from hoi.errors import ArtifactError, FrameFailure

OK = "ok"
_META = "meta"
_TIMESTAMP = (1980, 1, 1, 0, 0, 0)


def Array(dtype: str, *shape: int | None):
    """An array field: cast to `dtype`, `shape` checked (None: any length), values finite."""

    def check(value: Any) -> np.ndarray:
        array = np.asarray(value)
        if array.dtype == object or array.dtype.hasobject:
            raise ValueError("holds Python objects, expected numbers")
        array = np.ascontiguousarray(array, dtype=dtype)
        fits = array.ndim == len(shape) and all(
            want is None or want == have for want, have in zip(shape, array.shape, strict=True)
        )
        if not fits:
            raise ValueError(f"has shape {array.shape}, expected {shape}")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError("holds NaN or infinity")
        return array

    return Annotated[np.ndarray, BeforeValidator(check)]


if TYPE_CHECKING:  # what a type checker sees: arrays
    Image: TypeAlias = np.ndarray
    Mask: TypeAlias = np.ndarray
    Points3: TypeAlias = np.ndarray
    Faces: TypeAlias = np.ndarray
    Vector3: TypeAlias = np.ndarray
    Matrix3: TypeAlias = np.ndarray
    Box: TypeAlias = np.ndarray
else:  # what pydantic checks
    Image = Array("uint8", None, None, 3)
    Mask = Array("bool", None, None)
    Points3 = Array("float32", None, 3)
    Faces = Array("int64", None, 3)
    Vector3 = Array("float64", 3)
    Matrix3 = Array("float64", 3, 3)
    Box = Array("float64", 4)  # x0, y0, x1, y1 in pixels


class Artifact(BaseModel):
    """What one stage says about one frame.

    `status` is ``ok`` or a short reason; when it is not ``ok`` every stage result may be None.
    """

    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True, frozen=True)
    required_when_ok: ClassVar[tuple[str, ...]] = ()

    frame_id: str
    status: str = OK
    detail: str = ""
    failed_stage: str = ""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.status == OK:
            missing = [name for name in self.required_when_ok if getattr(self, name) is None]
            if missing:
                raise ValueError(f"status is ok, yet these fields are empty: {', '.join(missing)}")
        return self

    @property
    def ok(self) -> bool:
        return self.status == OK

    @classmethod
    def failed(cls, frame_id: str, failure: FrameFailure, stage: str) -> Self:
        """The artifact of a frame that could not pass `stage`."""
        return cls(
            frame_id=frame_id, status=failure.status, detail=failure.detail, failed_stage=stage
        )

    @classmethod
    def skipped(cls, frame_id: str, cause: Artifact) -> Self:
        """The artifact of a frame that already failed upstream; the first cause is kept."""
        return cls(
            frame_id=frame_id,
            status=cause.status,
            detail=cause.detail,
            failed_stage=cause.failed_stage,
        )

    def to_bytes(self) -> bytes:
        """The file content. Equal artifacts give equal bytes."""
        meta, arrays = {}, {}
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                arrays[name] = value
            elif isinstance(value, BaseModel):
                meta[name] = value.model_dump(mode="json")
            else:
                meta[name] = value
        text = json.dumps(meta, sort_keys=True, ensure_ascii=False, default=_jsonable)
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            archive.writestr(zipfile.ZipInfo(_META + ".json", _TIMESTAMP), text)
            for name, array in sorted(arrays.items()):
                entry = io.BytesIO()
                np.lib.format.write_array(entry, array, allow_pickle=False)
                info = zipfile.ZipInfo(name + ".npy", _TIMESTAMP)
                info.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(info, entry.getvalue())
        return buffer.getvalue()

    def save(self, path: Path | str) -> str:
        """Write the artifact and return the sha256 of its bytes."""
        data = self.to_bytes()
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        partial = Path(f"{path}.partial")
        partial.write_bytes(data)
        partial.replace(path)
        return hashlib.sha256(data).hexdigest()

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read and validate an artifact; raises ArtifactError naming file and field."""
        try:
            values: dict[str, Any] = {}
            with zipfile.ZipFile(path) as archive:
                for entry in archive.namelist():
                    stem, _, kind = entry.rpartition(".")
                    if entry == _META + ".json":
                        values.update(json.loads(archive.read(entry)))
                    elif kind == "npy":
                        stream = io.BytesIO(archive.read(entry))
                        values[stem] = np.lib.format.read_array(stream, allow_pickle=False)
                    else:
                        raise ArtifactError(f"{path}: unexpected entry {entry!r}")
            return cls(**values)
        except FileNotFoundError as error:
            raise ArtifactError(
                f"{path}: the file is not there; it was deleted by hand or its stage did not finish"
            ) from error
        except ValidationError as error:
            first = error.errors()[0]
            field = ".".join(str(part) for part in first["loc"]) or "(whole artifact)"
            raise ArtifactError(
                f"{path}: not a valid {cls.__name__}, field {field}: {first['msg']}"
            ) from error
        except ArtifactError:
            raise
        except Exception as error:  # whatever zip, zlib, json and numpy make of damaged bytes
            raise ArtifactError(f"{path}: not a readable {cls.__name__}: {error}") from error


def _jsonable(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} does not belong in an artifact's meta")


class Record(BaseModel):
    """A small structured value inside an artifact."""

    model_config = ConfigDict(extra="forbid", frozen=True)


# --------------------------------------------------------------------------------- inputs


class Hints(Record):
    """What the user said of who and what a photo is about, in pixels of its image.

    Boxes are x0, y0, x1, y1. A box is taken as it is; a point chooses among what was detected.
    """

    person: int | None = None  # which of the people, counted from the left, starting with 1
    person_box: tuple[float, float, float, float] | None = None
    person_point: tuple[float, float] | None = None
    object_box: tuple[float, float, float, float] | None = None
    object_point: tuple[float, float] | None = None
    action: str = ""  # what the person does; goes before the retrieved action


class Instance(Record):
    """One thing that another system segmented, as COCO names it."""

    label: str
    score: float


class Frame(Artifact):
    """One photo with its camera, and what the data set or another system says is in it.

    Keypoints are in the order of :data:`hoi.body.keypoints.KEYPOINTS`: x, y, confidence. Of
    several instances, people and poses the stages choose.
    """

    required_when_ok = ("image", "intrinsics")

    dataset: str = ""
    category: str = ""  # the object noun: chair, stool, table, keyboard, backpack, ...
    object_name: str = ""  # the data set's own name, e.g. chairblack
    action: str = ""  # the data set's action group, e.g. sit; only evaluation may look at it
    source: str = ""  # file name of the photo
    image: Image | None = None  # RGB
    intrinsics: Matrix3 | None = None
    intrinsics_source: str = ""
    given_person_mask: Mask | None = None
    given_object_mask: Mask | None = None
    given_keypoints: Array("float32", None, 3) | None = None  # type: ignore[valid-type]
    hints: Hints = Hints()
    # results of other systems, see hoi.readers: what -> format
    given_by: dict[str, str] = {}
    given_instances: list[Instance] = []
    given_instance_masks: Array("bool", None, None, None) | None = None  # type: ignore[valid-type]
    given_people: Array("float32", None, 21, 3) | None = None  # type: ignore[valid-type]
    # SMPL poses, axis-angle in the camera frame, the root first; and their shapes
    given_poses: Array("float64", None, 24, 3) | None = None  # type: ignore[valid-type]
    given_betas: Array("float64", None, None) | None = None  # type: ignore[valid-type]
    # contact probability of every vertex of the body model
    given_contacts: Array("float32", None) | None = None  # type: ignore[valid-type]


class GroundTruth(Artifact):
    """True meshes of one frame in its camera's frame. Only evaluation reads it."""

    required_when_ok = ("body_vertices", "body_faces", "object_vertices", "object_faces")

    body_model: str = ""  # identity of the body topology, compared before vertices are matched
    body_vertices: Points3 | None = None
    body_faces: Faces | None = None
    body_joints: Array("float32", 24, 3) | None = None  # type: ignore[valid-type]
    object_vertices: Points3 | None = None
    object_faces: Faces | None = None
    visible_fraction: float | None = None  # visible / full object silhouette


# --------------------------------------------------------------------------------- stages


class Candidate(Record):
    """One box that a detector proposed, what became of it and why."""

    label: str
    score: float
    box: tuple[float, float, float, float]
    verdict: str  # chosen, below_threshold, other_class, ...
    reason: str = ""  # the same in words, with the numbers that decided
    source: str = ""  # which detector, and in which part of the picture


class Detection(Artifact):
    """Section 3.1: the person, the object, their masks and the person's keypoints."""

    required_when_ok = ("person_box", "object_box", "person_mask", "object_mask", "keypoints")

    person_box: Box | None = None
    object_box: Box | None = None
    person_score: float | None = None
    object_score: float | None = None
    object_label: str = ""
    person_mask: Mask | None = None
    object_mask: Mask | None = None
    person_mask_source: str = ""
    object_mask_source: str = ""  # given, grabcut, ...
    keypoints: Array("float32", None, 3) | None = None  # type: ignore[valid-type]
    keypoints_source: str = ""
    # metres, hip-centred, camera axes; row order of KEYPOINTS
    landmarks: Points3 | None = None
    landmarks_source: str = ""
    candidates: list[Candidate] = []


class BodyFit(Artifact):
    """Section 3.1, Eq. 1: the body that explains the keypoints, in the camera frame."""

    required_when_ok = ("global_orient", "body_pose", "betas", "transl", "vertices", "joints")

    body_model: str = ""  # identity of the model, see hoi.body.BodyModel.identity
    global_orient: Vector3 | None = None
    body_pose: Array("float64", 69) | None = None  # type: ignore[valid-type]
    betas: Array("float64", None) | None = None  # type: ignore[valid-type]
    transl: Vector3 | None = None
    vertices: Points3 | None = None
    joints: Array("float32", 24, 3) | None = None  # type: ignore[valid-type]
    energy: dict[str, float] = {}
    reprojection_error_px: float | None = None
    initialisation: str = ""


class ObjectFit(Artifact):
    """Section 3.1: exemplars whose silhouette explains the mask, best first.

    Hypothesis k places exemplar `exemplars[k]` (vertices X of the library, at their library size)
    at ``X @ rotations[k].T + translations[k]`` in the camera frame. Size is not observable from a
    silhouette: the joint stage scales the placed object about the camera centre.
    """

    required_when_ok = ("exemplars", "rotations", "translations", "ious")

    category: str = ""
    exemplars: list[str] | None = None
    rotations: Array("float64", None, 3, 3) | None = None  # type: ignore[valid-type]
    translations: Array("float64", None, 3) | None = None  # type: ignore[valid-type]
    ious: Array("float64", None) | None = None  # type: ignore[valid-type]
    losses: Array("float64", None) | None = None  # type: ignore[valid-type]
    reasons: list[str] = []  # why each hypothesis was kept at its rank
    roi: Array("float64", 3) | None = None  # type: ignore[valid-type]  # x0, y0, side in pixels
    searched: int = 0  # number of (exemplar, start) pairs scored


class Neighbour(Record):
    """One retrieved pose of the database."""

    pose_id: str
    action: str
    distance: float
    probability: float = 0.0  # of its action, see Action.probability


class Action(Artifact):
    """Section 3.2: the action of the nearest pose in the database."""

    required_when_ok = ("action", "distance")

    action: str | None = None
    distance: float | None = None
    probability: float | None = None  # of the action, among those the database knows
    known: bool = True  # False: no pose of the database is near
    pose_id: str = ""  # the nearest pose; empty where the database has none with the object
    pose_distance: float | None = None  # of that pose; `distance` is that of the action's nearest
    runners_up: list[Neighbour] = []  # nearest pose of every other action, nearest first
    default_action: str = ""  # heaviest ConceptNet edge of the category ("No action" ablation)


class Contact(Record):
    """One row of the interaction map I: an object part that a body part touches.

    `side` is what the answer said of a paired body part, which `body_part` alone cannot: "hands"
    becomes one row for left_hand and one for right_hand, and `side` keeps whether both touch
    (`both`), one of them (`either`), this one by name (`left`, `right`), or the answer did not say
    (empty).
    """

    object_part: str  # label of the exemplar library, e.g. chair_seat
    body_part: str  # region of the body model, e.g. butt, left_hand
    side: Literal["", "left", "right", "both", "either"] = ""
    probability: float = 1.0
    source: str = ""


class ContactSet(Record):
    """One of several ways to do the same: a chair is carried by its back, its seat *or* its arms.

    A set replaces the contacts of its interaction, it does not add to them. One without contacts
    says that nothing touches.
    """

    name: str
    contacts: list[Contact]
    probability: float = 1.0
    source: str = ""


class Arrangement(Record):
    """Where the object is, seen from the person, and which way its front looks.

    `relation` is in the person's own frame (front: before the chest). `facing` compares the
    object's front (a chair's seat side, a screen) with the person's: same, opposite (they face each
    other), sideways. Empty: not said.
    """

    relation: Literal["", "front", "behind", "below", "above", "beside"] = ""
    facing: Literal["", "same", "opposite", "sideways"] = ""
    source: str = ""


class Extent(Record):
    """A length in metres as a range: `low` to `high` hold most things of the kind."""

    low: float
    typical: float
    high: float


class Extents(Record):
    """Sizes along the object's own axes; what nobody said is None."""

    height: Extent | None = None
    width: Extent | None = None
    depth: Extent | None = None
    source: str = ""


class Interaction(Record):
    """What the language model says of one action with one object.

    `alternatives`, `no_contact` (probability that nothing touches) and `arrangement` are more than
    the paper asks for; empty, 0 and None where nobody said it.
    """

    action: str
    contacts: list[Contact]
    alternatives: list[ContactSet] = []
    no_contact: float = 0.0
    arrangement: Arrangement | None = None
    unmapped: list[str] = []  # answers that name no known part, with the reason
    stands_on_floor: bool = False
    feet_on_floor: bool = True  # False: feet may hang, or stand on the object
    probability: float = 1.0  # that the person does this
    source: str = ""


class Prior(Artifact):
    """Section 3.3: object size and contacts, looked up and never invented."""

    required_when_ok = ("size_m", "retrieved", "default")

    category: str = ""
    size_m: float | None = None
    size_axis: str = "longest"  # longest | height: the extent that size_m measures
    size_source: str = ""
    extents: Extents | None = None  # more than the paper's single size, where somebody said it
    retrieved: Interaction | None = None
    default: Interaction | None = None
    true: Interaction | None = None  # of the data set's own action: for oracles alone
    hypotheses: list[Interaction] = []  # likely interactions that differ, most probable first


class Joint(Artifact):
    """Section 3.4, Eq. 5: body and object placed together, in the camera frame (metres)."""

    required_when_ok = ("object_vertices", "object_faces", "body_vertices", "object_scale")

    method: str = ""
    exemplar: str = ""
    action: str = ""
    object_rotation: Matrix3 | None = None
    object_translation: Vector3 | None = None
    object_scale: float | None = None
    human_scale: float | None = None
    object_vertices: Points3 | None = None
    object_faces: Faces | None = None
    body_vertices: Points3 | None = None
    body_joints: Array("float32", 24, 3) | None = None  # type: ignore[valid-type]
    body_model: str = ""
    body_pose: Array("float64", 69) | None = None  # type: ignore[valid-type]  # refined limbs
    limb_gaps: dict[str, tuple[float, float]] = {}  # metres before and after their refinement
    contact_vertices: Array("float32", None) | None = None  # type: ignore[valid-type]
    intrinsics: Matrix3 | None = None  # of the camera believed in, where it is not the photo's
    # per hypothesis: the terms of the final loss, what selection saw, the winner
    hypothesis_exemplars: list[str] = []
    hypothesis_contacts: list[str] = []  # the contact set each one followed; empty: there was one
    hypothesis_actions: list[str] = []
    hypothesis_terms: dict[str, list[float]] = {}
    selected: int | None = None
    selection_rule: str = ""
    loss_curve: dict[str, list[float]] = {}  # of the selected hypothesis, by term


class Measure(Record):
    """Errors of one frame under one more protocol; `name` is a key of the configuration."""

    name: str
    protocol: str
    human_cm: float
    object_cm: float


class ContactScore(Record):
    """How well the body vertices that touch the object are found, at one distance.

    A share is None where it is not defined: no vertex touches in the result (precision) or in
    truth (recall).
    """

    threshold_cm: float
    precision: float | None
    recall: float | None
    correspondence: str  # how true contacts were carried to the fitted body's vertices


class Evaluation(Artifact):
    """Section 4.2: errors of one method on one frame."""

    required_when_ok = ("human_cm", "object_cm")

    dataset: str = ""
    category: str = ""
    object_name: str = ""
    true_action: str = ""
    used_action: str = ""
    method: str = ""
    protocol: str = ""
    human_cm: float | None = None
    object_cm: float | None = None
    others: list[Measure] = []  # the same reconstruction under other protocols
    contacts: list[ContactScore] = []
