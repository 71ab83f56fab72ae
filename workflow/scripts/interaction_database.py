"""Collect the fitted bodies of searched images into a pose database, and count what was dropped."""

from pathlib import Path

import pandas as pd
from chunk_job import logged

from hoi.actions.database import load_database, save_database
from hoi.artifacts import BodyFit, Detection, Frame
from hoi.chunks import read_artifacts
from hoi.errors import AssetError
from hoi.interactions.collect import (
    collect,
    counts_table,
    duplicates,
    joined,
    outcome,
    picture_digest,
)
from hoi.interactions.config import InteractionsConfig

config = InteractionsConfig(**snakemake.params.identity["settings"])
planned = snakemake.params.frames


def artifacts(kind, indexes):
    return (artifact for index in indexes for artifact in read_artifacts(kind, index))


with logged(snakemake):
    pictures = map(picture_digest, artifacts(Frame, snakemake.input.frames))
    repeated = duplicates(
        [(p, f["category"], f["action"]) for p, f in zip(pictures, planned, strict=True)]
    )
    stages = zip(
        planned,
        repeated,
        artifacts(Frame, snakemake.input.frames),
        artifacts(Detection, snakemake.input.detections),
        artifacts(BodyFit, snakemake.input.bodies),
        strict=True,
    )
    outcomes = [
        outcome(
            info["object_name"],
            again,
            frame,
            detection,
            body,  # type: ignore[arg-type]  # zip of so many kinds loses them
            config,
            (info["category"], info["action"]),
        )
        for info, again, frame, detection, body in stages
    ]
    counts_table(outcomes).to_csv(snakemake.output.counts, index=False, float_format="%.3f")
    told = [(o.frame_id, o.query, o.category, o.action, o.status) for o in outcomes]
    columns = ["image", "query", "category", "action", "status"]
    pd.DataFrame(told, columns=columns).to_csv(snakemake.output.images, index=False)
    database = collect(outcomes, config)
    if config.with_package:
        package = load_database(snakemake.input.package)
        database = package if database is None else joined(package, database)
    if database is None:
        raise AssetError(
            "no image passed the filters, so there is no database; "
            f"{Path(snakemake.output.counts).name} would have said why: "
            + ", ".join(f"{status} {sum(o.status == status for o in outcomes)}"
                        for status in sorted({o.status for o in outcomes}))
        )  # fmt: skip
    save_database(database, snakemake.output.database)
