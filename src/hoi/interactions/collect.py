"""Fitted bodies of labelled images -> a pose database, and how many images each filter dropped."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from hoi.actions.database import PoseDatabase
from hoi.actions.retrieval import pelvis_up_in_camera
from hoi.artifacts import OK, BodyFit, Detection, Frame
from hoi.body.skeleton import mirror_pose
from hoi.errors import FrameFailure
from hoi.interactions.config import InteractionsConfig
from hoi.interactions.filters import check_fit

DUPLICATE = "duplicate"
KEPT = "kept"
# in the order in which images meet the filters
REASONS = ("image_missing", "image_unreadable", "too_small", DUPLICATE, "no_person_detected",
           "several_people", "no_object_detected", "several_objects", "no_interaction",
           "poor_body_fit")  # fmt: skip
ALL = "all"


class Outcome(NamedTuple):
    """What became of one image: `status` is ``kept`` or the reason why not."""

    query: str
    category: str
    action: str
    frame_id: str
    status: str
    body_pose: np.ndarray | None = None  # (69,) radians
    pelvis_up: np.ndarray | None = None  # (3,)


def outcome(
    query: str,
    duplicate: bool,
    frame: Frame,
    detection: Detection,
    body: BodyFit,
    config: InteractionsConfig,
    labels: tuple[str, str],
) -> Outcome:
    """One image's outcome from the artifacts of its stages, the first failure counting.

    Args:
        duplicate: whether the same picture came earlier under the same labels.
        labels: category and action.
    """
    status = next((a.status for a in (frame, detection, body) if a.status != OK), KEPT)
    if duplicate and frame.ok:
        status = DUPLICATE
    if status == KEPT:
        try:
            check_fit(body.reprojection_error_px, detection, config)
        except FrameFailure as failure:
            status = failure.status
    pose = up = None
    if status == KEPT:
        assert body.body_pose is not None and body.global_orient is not None
        pose, up = body.body_pose, pelvis_up_in_camera(body.global_orient)
    return Outcome(query, *labels, frame.frame_id, status, pose, up)


def picture_digest(frame: Frame) -> str:
    """sha256 of a frame's pixels, whatever its file is called; a failed frame is like no other."""
    if frame.image is None:
        return f"none: {frame.frame_id}"
    return hashlib.sha256(str(frame.image.shape).encode() + frame.image.tobytes()).hexdigest()


def duplicates(digests: Sequence[tuple[str, str, str]]) -> list[bool]:
    """Whether the same picture came earlier for the same category and action.

    Args:
        digests: (digest of its pixels, category, action) of each image, in order.
    """
    seen: set[tuple[str, str, str]] = set()
    return [key in seen or seen.add(key) is not None for key in digests]


def collect(outcomes: Iterable[Outcome], config: InteractionsConfig) -> PoseDatabase | None:
    """The database of the kept images; None when none was kept.

    Poses are named after their image, with ``_00``, and ``_01`` for the mirrored one.
    """
    ids, categories, actions, poses, ups = [], [], [], [], []
    for kept in outcomes:
        if kept.body_pose is None or kept.pelvis_up is None:
            continue
        variants = [(kept.body_pose, kept.pelvis_up)]
        if config.mirrored:
            variants.append((mirror_pose(kept.body_pose), kept.pelvis_up * (-1, 1, 1)))
        for number, (pose, up) in enumerate(variants):
            ids.append(f"{kept.frame_id}_{number:02d}")
            categories.append(kept.category)
            actions.append(kept.action)
            poses.append(pose)
            ups.append(up)
    if not ids:
        return None
    return PoseDatabase(
        np.array(ids),
        np.array(categories),
        np.array(actions),
        np.round(np.stack(poses), 4).astype(np.float32),
        np.round(np.stack(ups), 4).astype(np.float32),
    )


def joined(first: PoseDatabase, second: PoseDatabase) -> PoseDatabase:
    """One database of the poses of both; tilts are kept only when both know them."""

    def both(key: str) -> np.ndarray:
        return np.concatenate([getattr(first, key), getattr(second, key)])

    ups = None
    if first.pelvis_up is not None and second.pelvis_up is not None:
        ups = np.concatenate([first.pelvis_up, second.pelvis_up])
    return PoseDatabase(
        both("pose_ids"), both("categories"), both("actions"), both("body_pose"), ups
    )


def counts_table(outcomes: Sequence[Outcome]) -> pd.DataFrame:
    """One row per query, and ``all``: images, how many each filter dropped, and what is left.

    Columns: query, category, action, images, one per reason, other (any other failure), kept,
    kept_share.
    """
    groups: dict[tuple[str, str, str], Counter[str]] = {}
    for found in outcomes:
        key = (found.query, found.category, found.action)
        groups.setdefault(key, Counter())[found.status] += 1
    rows = [_row(*key, counts) for key, counts in sorted(groups.items())]
    rows.append(_row(ALL, "", "", sum(groups.values(), Counter())))
    return pd.DataFrame(rows)


def _row(query: str, category: str, action: str, counts: Counter[str]) -> dict[str, object]:
    total = sum(counts.values())
    named = {reason: counts[reason] for reason in REASONS}
    kept = counts[KEPT]
    return {
        "query": query,
        "category": category,
        "action": action,
        "images": total,
        **named,
        "other": total - kept - sum(named.values()),
        "kept": kept,
        "kept_share": kept / total if total else 0.0,
    }
