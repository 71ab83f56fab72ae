"""A person of boxes on a chair of boxes, and the artifacts that every stage would write of them."""

from __future__ import annotations

import numpy as np

from hoi.artifacts import (
    Action,
    Arrangement,
    BodyFit,
    Candidate,
    Contact,
    ContactSet,
    Detection,
    Evaluation,
    Extent,
    Extents,
    Frame,
    GroundTruth,
    Interaction,
    Joint,
    Neighbour,
    ObjectFit,
    Prior,
)
from hoi.body.keypoints import KEYPOINTS
from hoi.errors import FrameFailure
from hoi.exemplars import Exemplar
from hoi.report.page import MethodView

INTRINSICS = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
HEIGHT, WIDTH = 480, 640

_BOX = np.array(
    [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4]]
    + [[1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
)


def boxes(*extents: tuple[tuple[float, float, float], tuple[float, float, float]]):
    """Vertices and faces of boxes given by two opposite corners each (y down, camera axes)."""
    vertices, faces = [], []
    for low, high in extents:
        (x0, y0, z0), (x1, y1, z1) = low, high
        faces.append(_BOX + 8 * len(vertices))
        vertices.append(
            [[x0, y0, z0], [x1, y0, z0], [x1, y1, z0], [x0, y1, z0]]
            + [[x0, y0, z1], [x1, y0, z1], [x1, y1, z1], [x0, y1, z1]]
        )
    return np.concatenate(vertices).astype(np.float32), np.concatenate(faces)


def person():
    """1.7 m tall, standing on y = 1, centred on x = 0, z = 3 (camera frame)."""
    return boxes(
        ((-0.1, -0.7, 2.9), (0.1, -0.45, 3.1)),
        ((-0.22, -0.45, 2.9), (0.22, 0.2, 3.1)),
        ((-0.2, 0.2, 2.92), (-0.03, 1.0, 3.08)),
        ((0.03, 0.2, 2.92), (0.2, 1.0, 3.08)),
        ((0.22, -0.4, 2.92), (0.32, 0.2, 3.08)),
        ((-0.32, -0.4, 2.92), (-0.22, 0.2, 3.08)),
    )


def chair(x: float = 0.34, z: float = 2.8):
    """0.9 m tall on the same floor; its left edge is `x`, its near edge `z`."""
    return boxes(
        ((x, 0.52, z), (x + 0.45, 0.57, z + 0.45)),
        ((x, 0.1, z + 0.41), (x + 0.45, 0.52, z + 0.45)),
        *(((a, 0.57, b), (a + 0.04, 1.0, b + 0.04)) for a in (x, x + 0.41) for b in (z, z + 0.41)),
    )


def exemplar(name: str, stretch: float = 1.0) -> Exemplar:
    """A chair in its canonical frame: y up, centred."""
    vertices, faces = chair()
    upright = vertices * [1, -stretch, -1]
    upright -= (upright.min(axis=0) + upright.max(axis=0)) / 2
    return Exemplar(
        name, "chair", upright, faces, ("chair_seat",), np.zeros(len(faces), int), "test", "CC0"
    )


def exemplars() -> list[Exemplar]:
    return [exemplar(f"box_chair_{k}", 1.0 - 0.08 * k) for k in range(5)]


def _pixels(points: np.ndarray) -> np.ndarray:
    image = points @ INTRINSICS.T
    return image[:, :2] / image[:, 2:]


def _box_of(points: np.ndarray) -> np.ndarray:
    pixels = _pixels(points)
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


def _mask(points: np.ndarray) -> np.ndarray:
    x0, y0, x1, y1 = np.round(_box_of(points)).astype(int)
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[max(y0, 0) : y1, max(x0, 0) : x1] = True
    return mask


def frame(frame_id: str = "Date00_Sub00_chair_sit/t0001.000", **changes) -> Frame:
    """A photo of a plain room with sensor noise, so that JPEG sizes are those of photos."""
    rng = np.random.default_rng(0)
    wall = np.linspace([196, 190, 180], [168, 164, 158], HEIGHT)[:, None]
    image = np.broadcast_to(wall, (HEIGHT, WIDTH, 3)).copy()
    image[330:] = np.linspace([120, 104, 88], [150, 132, 112], HEIGHT - 330)[:, None]
    image = np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)
    values = dict(
        frame_id=frame_id,
        dataset="behave_mini",
        category="chair",
        object_name="chairwood",
        action="sit",
        source="k1.color.jpg",
        image=image,
        intrinsics=INTRINSICS,
        intrinsics_source="calibration",
    )
    return Frame(**{**values, **changes})


def detection(frame_id: str = "f") -> Detection:
    body, _ = person()
    thing, _ = chair()
    rng = np.random.default_rng(1)
    points = np.column_stack(
        [
            rng.uniform(-0.25, 0.25, len(KEYPOINTS)),
            np.linspace(-0.6, 1.0, len(KEYPOINTS)),
            np.full(len(KEYPOINTS), 2.9),
        ]
    )
    confidence = np.where(np.arange(len(KEYPOINTS)) % 7 == 3, 0.1, 0.9)
    return Detection(
        frame_id=frame_id,
        person_box=_box_of(body),
        object_box=_box_of(thing),
        person_score=0.97,
        object_score=0.91,
        object_label="chair",
        person_mask=_mask(body),
        object_mask=_mask(thing),
        person_mask_source="given",
        object_mask_source="given",
        keypoints=np.column_stack([_pixels(points), confidence]),
        keypoints_source="given",
        candidates=[
            Candidate(label="person", score=0.97, box=(1, 2, 3, 4), verdict="chosen"),
            Candidate(label="couch", score=0.41, box=(5, 6, 7, 8), verdict="other_class"),
        ],
    )


def body_fit(frame_id: str = "f", vertices: np.ndarray | None = None) -> BodyFit:
    return BodyFit(
        frame_id=frame_id,
        body_model="boxes",
        global_orient=np.array([np.pi, 0, 0]),
        body_pose=np.zeros(69),
        betas=np.zeros(10),
        transl=np.array([0, 0, 3.0]),
        vertices=person()[0] if vertices is None else vertices,
        joints=np.zeros((24, 3)),
        energy={"joints": 12.5, "pose": 3.25, "shape": 0.125},
        reprojection_error_px=4.2,
        initialisation="landmarks",
    )


def object_fit(frame_id: str = "f") -> ObjectFit:
    placed, _ = chair()
    centre = (placed.min(axis=0) + placed.max(axis=0)) / 2
    flip = np.diag([1.0, -1.0, -1.0])
    return ObjectFit(
        frame_id=frame_id,
        category="chair",
        exemplars=[f"box_chair_{k}" for k in range(5)],
        rotations=np.stack([flip] * 5),
        translations=np.stack([centre] * 5).astype(float),
        ious=np.array([0.91, 0.88, 0.84, 0.8, 0.77]),
        losses=np.array([10.0, 12, 15, 19, 22]),
        reasons=["best silhouette", "other exemplar", "other exemplar", "other yaw", "other yaw"],
        roi=np.array([300.0, 200, 150]),
        searched=480,
    )


def action(frame_id: str = "f") -> Action:
    return Action(
        frame_id=frame_id,
        action="sit",
        distance=0.84,
        runners_up=[
            Neighbour(pose_id="pose_017", action="carry", distance=1.2),
            Neighbour(pose_id="pose_101", action="sleep", distance=1.4),
        ],
        default_action="sit",
    )


def prior(frame_id: str = "f") -> Prior:
    seat = Contact(object_part="chair_seat", body_part="butt", source="paper table 6")
    back = Contact(object_part="chair_back", body_part="back", source="ours")
    return Prior(
        frame_id=frame_id,
        category="chair",
        size_m=0.85,
        size_axis="height",
        size_source="paper table 5",
        retrieved=Interaction(
            action="sit",
            contacts=[seat, back],
            unmapped=["cushion: no such part"],
            alternatives=[
                ContactSet(name="leaning back", contacts=[seat, back], probability=0.65),
                ContactSet(name="upright", contacts=[seat], probability=0.35),
            ],
            no_contact=0.1,
            arrangement=Arrangement(relation="below", facing="same"),
            stands_on_floor=True,
            source="paper",
        ),
        extents=Extents(height=Extent(low=0.75, typical=0.87, high=1.15)),
        default=Interaction(action="sit", contacts=[seat], source="paper"),
    )


def joint(
    frame_id: str = "f", method: str = "ours", x: float = 0.34, vertices: np.ndarray | None = None
) -> Joint:
    body = person()[0] if vertices is None else vertices
    thing, faces = chair(x)
    steps = np.linspace(0, 4, 60)
    return Joint(
        frame_id=frame_id,
        method=method,
        exemplar="box_chair_0",
        action="sit",
        object_rotation=np.eye(3),
        object_translation=np.array([0.0, 0, 0]),
        object_scale=1.02,
        human_scale=1.0,
        object_vertices=thing,
        object_faces=faces,
        body_vertices=body,
        body_model="boxes",
        hypothesis_exemplars=["box_chair_0", "box_chair_1"],
        hypothesis_terms={
            "contact": [0.02, 0.05],
            "scale": [0.001, 0.002],
            "total": [0.021, 0.052],
        },
        selected=0,
        selection_rule="lowest total",
        loss_curve={
            "contact": (0.02 + 0.6 * np.exp(-steps)).tolist(),
            "scale": (0.001 + 0.05 * np.exp(-2 * steps)).tolist(),
        },
    )


def evaluation(frame_id: str = "f", method: str = "ours", object_cm: float = 9.3) -> Evaluation:
    return Evaluation(
        frame_id=frame_id,
        dataset="behave_mini",
        category="chair",
        object_name="chairwood",
        true_action="sit",
        used_action="sit",
        method=method,
        protocol="smpl",
        human_cm=4.1,
        object_cm=object_cm,
    )


def truth(frame_id: str = "f") -> GroundTruth:
    body, body_faces = person()
    thing, faces = chair(0.3)
    return GroundTruth(
        frame_id=frame_id,
        body_vertices=body,
        body_faces=body_faces,
        object_vertices=thing,
        object_faces=faces,
    )


def method(name: str, x: float = 0.34, object_cm: float = 9.3, **changes) -> MethodView:
    values = dict(
        name=name,
        body=body_fit(),
        objects=object_fit(),
        action=action(),
        prior=prior(),
        joint=joint(method=name, x=x),
        evaluation=evaluation(method=name, object_cm=object_cm),
    )
    return MethodView(**{**values, **changes})


def failed(kind: type, status: str, detail: str, stage: str, frame_id: str = "f"):
    """The artifact of a frame that stopped at `stage`."""
    return kind.failed(frame_id, FrameFailure(status, detail), stage)
