"""Collect the photos into one table: what came out, or which stage stopped and why."""

import json
from collections import Counter
from pathlib import Path

import pandas as pd
from chunk_job import logged

from hoi.artifacts import BodyFit, Frame, Joint
from hoi.chunks import read_artifacts

COLUMNS = [
    "photo", "object", "status", "failed_stage", "detail", "action", "exemplar", "object_size",
    "keypoint_error_px", "intrinsics", "scene", "overlay", "seconds",
]  # fmt: skip

with logged(snakemake):
    seconds: Counter[str] = Counter()
    for path in snakemake.input.seconds:
        seconds.update(json.loads(Path(path).read_text()))
    scenes = {}
    for path in snakemake.input.scenes:
        folder = Path(path).parent
        for frame_id, files in json.loads(Path(path).read_text()).items():
            scenes[frame_id] = {kind: str(folder / name) for kind, name in files.items()}
    bodies = {
        b.frame_id: b for path in snakemake.input.bodies for b in read_artifacts(BodyFit, path)
    }
    joints = {j.frame_id: j for path in snakemake.input.joints for j in read_artifacts(Joint, path)}
    rows = []
    for path in snakemake.input.frames:
        for frame in read_artifacts(Frame, path):
            joint, body = joints[frame.frame_id], bodies[frame.frame_id]
            size = ""
            if joint.object_vertices is not None:
                extent = joint.object_vertices.max(0) - joint.object_vertices.min(0)
                size = " x ".join(f"{side:.2f}" for side in extent) + " m"
            rows.append(
                {
                    "photo": frame.source or frame.frame_id,
                    "object": frame.category,
                    "status": joint.status,
                    "failed_stage": joint.failed_stage,
                    "detail": joint.detail,
                    "action": joint.action,
                    "exemplar": joint.exemplar,
                    "object_size": size,
                    "keypoint_error_px": body.reprojection_error_px,
                    "intrinsics": frame.intrinsics_source,
                    "scene": scenes[frame.frame_id].get("scene", ""),
                    "overlay": scenes[frame.frame_id].get("overlay", ""),
                    "seconds": round(seconds[frame.frame_id], 1),
                }
            )
    pd.DataFrame(rows, columns=COLUMNS).to_csv(
        snakemake.output[0], index=False, float_format="%.2f"
    )
