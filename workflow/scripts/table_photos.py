"""Collect the photos into one table: what came out, or which stage stopped and why."""

import json
from collections import Counter
from pathlib import Path

import pandas as pd
from chunk_job import logged

from hoi.artifacts import BodyFit, Detection, Frame, Joint, ObjectFit
from hoi.chunks import read_artifacts
from hoi.report.photos import COLUMNS, photo_row

with logged(snakemake):
    seconds: Counter[str] = Counter()
    for path in snakemake.input.seconds:
        seconds.update(json.loads(Path(path).read_text()))
    rows = []
    chunks = zip(
        *(
            snakemake.input[name]
            for name in ("frames", "detections", "bodies", "objects", "joints", "scenes")
        ),
        strict=True,
    )
    for frames, detections, bodies, objects, joints, scenes in chunks:
        folder = Path(scenes).parent
        written = json.loads(Path(scenes).read_text())
        artifacts = zip(
            read_artifacts(Frame, frames),
            read_artifacts(Detection, detections),
            read_artifacts(BodyFit, bodies),
            read_artifacts(ObjectFit, objects),
            read_artifacts(Joint, joints),
            strict=True,
        )
        for frame, detection, body, fit, joint in artifacts:
            files = {kind: str(folder / name) for kind, name in written[frame.frame_id].items()}
            spent = seconds[frame.frame_id]
            rows.append(photo_row(frame, detection, body, fit, joint, files, spent))
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    table.to_csv(snakemake.output[0], index=False, float_format="%.2f")
