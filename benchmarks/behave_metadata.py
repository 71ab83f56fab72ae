"""How long the metadata of a tree as large as BEHAVE's test split takes.

    python benchmarks/behave_metadata.py [folder]

Generates a tree of 4,554 frames (the size of the test split of later papers) in the released
layout, one full-size picture linked into every frame, and times what a run does before it starts:
listing the frames of all tables, `hoi check-data`'s look into every frame, and the digests of the
raw files, once afresh and once remembered.

Measured on a 2-core virtual machine that twenty other jobs wanted: metadata 2.1 s of CPU, 4.9 s by
the clock (0.4 s listing, 4.5 s looking into pictures' headers, keypoints and fits of every frame);
remembered digests 1.7 s of CPU. Digests afresh hash all raw files, about 1 GB/s.
"""

from __future__ import annotations

import itertools
import json
import os
import pickle
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

from hoi.checks.behave_frames import survey
from hoi.datasets.behave import frame_files, ground_truth_files, list_frames
from hoi.datasets.behave_config import BehaveConfig
from hoi.datasets.behave_layout import (
    ACTION_GROUPS,
    TABLE_GROUPS,
    object_folder_names,
    sequence_name,
)
from hoi.manifest import FileDigests

FRAMES = 4554
PER_SEQUENCE = 51


def generate(root: Path, frames: int = FRAMES, size: tuple[int, int] = (2048, 1536)) -> None:
    """A tree of `frames` frames; their files are hard links to one frame's."""
    model = root / "model"
    model.mkdir(parents=True)
    noise = np.random.default_rng(0).integers(0, 255, (*size[::-1], 3), np.uint8)
    Image.fromarray(noise).resize((size[0] // 8, size[1] // 8)).resize(size).save(
        model / "k1.color.jpg"
    )
    mask = np.zeros(size[::-1], np.uint8)
    mask[100:700, 200:900] = 255
    for stem in ("person_mask", "obj_rend_mask", "obj_rend_full"):
        Image.fromarray(mask).save(model / f"k1.{stem}.png")
    joints = np.random.default_rng(1).random(75).tolist()
    hands = {"face_joints": [0.5] * 210, "left_hand_joints": [0.5] * 63}
    (model / "k1.color.json").write_text(json.dumps({"body_joints": joints} | hands))
    (model / "fit.ply").write_bytes(b"ply\n" + bytes(200_000))
    (model / "fit.pkl").write_bytes(pickle.dumps({"angle": np.zeros(3), "trans": np.zeros(3)}))
    names = [
        sequence_name("Date03", subject, thing, action)
        for subject, (thing, actions) in itertools.product(
            (f"Sub{number:02d}" for number in range(1, 9)), ACTION_GROUPS.items()
        )
        for action in actions
    ]
    written = 0
    for name in names:
        if written == frames:
            break
        _write_sequence(root, model, name, min(PER_SEQUENCE, frames - written))
        written += min(PER_SEQUENCE, frames - written)
    assert written == frames
    (root / "split.json").write_text(json.dumps({"train": [], "test": names}))


def _write_sequence(root: Path, model: Path, name: str, frames: int) -> None:
    folder = root / "sequences" / name
    folder.mkdir(parents=True)
    info = {"gender": "male", "config": "../../calibs/Date03/config", "kinects": [0, 1, 2, 3],
            "intrinsic": "../../calibs/intrinsics"}  # fmt: skip
    (folder / "info.json").write_text(json.dumps(info))
    thing = object_folder_names(name.split("_")[2])[0]
    for second in range(3, 3 + frames):
        frame = folder / f"t{second:04d}.000"
        for inner in ("person/fit02", f"{thing}/fit01"):
            (frame / inner).mkdir(parents=True)
        for path in model.glob("k1.*"):
            os.link(path, frame / path.name)
        for suffix in ("ply", "pkl"):
            os.link(model / f"fit.{suffix}", frame / "person/fit02" / f"person_fit.{suffix}")
            os.link(model / f"fit.{suffix}", frame / f"{thing}/fit01" / f"{thing}_fit.{suffix}")


def metadata(root: Path) -> tuple[int, float, float]:
    """Frames listed over all tables, seconds of listing and of looking into each."""
    config = BehaveConfig(root=str(root))
    started = time.perf_counter()
    refs = [ref for group in TABLE_GROUPS for ref in list_frames(root, group, "test", config)]
    listed = time.perf_counter()
    found = survey(root, refs, config)
    assert all(seen.listed for seen in found)
    return len(refs), listed - started, time.perf_counter() - listed


def digests(root: Path, memo: Path) -> float:
    """Seconds for the digests of all frames' raw files."""
    config = BehaveConfig(root=str(root))
    refs = [ref for group in TABLE_GROUPS for ref in list_frames(root, group, "test", config)]
    started = time.perf_counter()
    with FileDigests(memo) as known:
        for ref in refs:
            known.of([*frame_files(root, ref, config), *ground_truth_files(root, ref, config)])
    return time.perf_counter() - started


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(scratch) / "behave"
        if not root.exists():
            generate(root)
        count, listing, looking = metadata(root)
        print(f"{count} frames: listed in {listing:.1f} s, looked into in {looking:.1f} s")
        memo = Path(scratch) / "digests.json"
        afresh, remembered = digests(root, memo), digests(root, memo)
        print(f"digests of their files: {afresh:.1f} s afresh, {remembered:.1f} s remembered")


if __name__ == "__main__":
    main()
