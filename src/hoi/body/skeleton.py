"""The 24-joint kinematic tree of SMPL: names, parents, mirror images."""

import numpy as np

JOINT_NAMES: tuple[str, ...] = (
    "pelvis",
    "left_hip",
    "right_hip",
    "spine1",
    "left_knee",
    "right_knee",
    "spine2",
    "left_ankle",
    "right_ankle",
    "spine3",
    "left_foot",
    "right_foot",
    "neck",
    "left_collar",
    "right_collar",
    "head",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hand",
    "right_hand",
)
NUM_JOINTS = len(JOINT_NAMES)
JOINT: dict[str, int] = {name: index for index, name in enumerate(JOINT_NAMES)}

#: Parent of every joint; the root's is -1. A parent always has a smaller index than its child.
PARENTS: tuple[int, ...] = (
    *(-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8),
    *(9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21),
)


def _mirror_name(name: str) -> str:
    side, _, rest = name.partition("_")
    return {"left": f"right_{rest}", "right": f"left_{rest}"}.get(side, name)


#: Index of each joint's mirror image (left_knee <-> right_knee, spine1 <-> spine1).
MIRROR: tuple[int, ...] = tuple(JOINT[_mirror_name(name)] for name in JOINT_NAMES)


def levels() -> list[list[int]]:
    """Joints grouped by their depth in the tree; every parent is in the group before."""
    depth = [0] * NUM_JOINTS
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            depth[joint] = depth[parent] + 1
    return [[j for j in range(NUM_JOINTS) if depth[j] == d] for d in range(max(depth) + 1)]


def mirror_pose(body_pose: np.ndarray) -> np.ndarray:
    """The left-right mirror image of axis-angle body poses (..., 69), radians.

    Reflection in the sagittal plane keeps the x component of an axis-angle vector and negates
    y and z, and swaps the joints of the two sides.
    """
    pose = np.asarray(body_pose).reshape(*np.shape(body_pose)[:-1], NUM_JOINTS - 1, 3)
    swapped = pose[..., [index - 1 for index in MIRROR[1:]], :]
    return (swapped * np.array([1.0, -1.0, -1.0])).reshape(np.shape(body_pose))
