"""``hoi detection``: how well people and objects are found on labelled photos."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from hoi.config import load_config


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Where the labelled photos are, and what to write."""
    parser.add_argument(
        "folder", type=Path, help="photos with labels.csv, or COCO's (docs/detection.md)"
    )
    parser.add_argument(
        "--coco",
        choices=("dev", "test"),
        help="the folder is COCO's; measure on this split of our pairs of people and objects in it",
    )
    parser.add_argument("--config", type=Path, default=Path("config/config.yaml"))
    parser.add_argument("--models", type=Path, default=Path("resources/models"))
    parser.add_argument(
        "--out", type=Path, help="folder for detection.csv, masks.csv, photos.csv, photos.html"
    )
    parser.add_argument("--no-masks", action="store_true", help="do not compare ways to cut out")


def run(arguments: argparse.Namespace) -> int:
    """Print the tables; fetches the model files where they are not there yet."""
    import pandas as pd

    from hoi.artifacts import Detection, Frame
    from hoi.datasets.coco_pairs import read_coco_pairs
    from hoi.datasets.labelled import read_labelled
    from hoi.detect.agreement import detection_table, frame_agreement
    from hoi.detect.mask_methods import compare_masks, mask_methods, mask_rows, mask_table
    from hoi.detect.models import fetch_models
    from hoi.detect.stage import DetectStage
    from hoi.errors import FrameFailure
    from hoi.report.config import ReportConfig
    from hoi.report.detection import detection_layout, masks_layout
    from hoi.report.labelled import labelled_page, labelled_photo
    from hoi.report.tables import as_text

    config = load_config(arguments.config)
    settings = config.detect_photos.model_copy(update={"masks": "registry"})
    fetch_models(arguments.models, settings.needed_models)
    stage = DetectStage(settings, arguments.models)
    name = "coco" if arguments.coco else arguments.folder.name
    methods = {} if arguments.no_masks else mask_methods(settings)
    drawn = ReportConfig()
    photos: list[dict[str, object]] = []
    shown = []
    masks: list[dict[str, object]] = []

    def looked() -> Iterator[tuple[Frame, Detection]]:
        frames = (
            read_coco_pairs(arguments.folder, arguments.coco)
            if arguments.coco
            else read_labelled(arguments.folder)
        )
        for frame in frames:
            try:
                found = stage(frame, config.seed)
            except FrameFailure as failure:
                found = getattr(failure, "artifact", None) or Detection.failed(
                    frame.frame_id, failure, "detect"
                )
            agreement = frame_agreement(frame, found, settings)
            photos.append(
                {
                    "photo": frame.source,
                    "category": frame.category,
                    "status": found.status,
                    "right": agreement["box_right"] or agreement["mask_right"],
                    **{key: agreement[key] for key in ("object_iou", "box_iou", "person_iou")},
                    "object_mask": found.object_mask_source,
                    "detail": found.detail,
                }
            )
            if arguments.out is not None:
                shown.append(labelled_photo(frame, found, agreement, drawn))
            pose = stage.pose_of(frame, found) if methods else None
            if pose is not None:
                masks.extend(compare_masks(frame, found, pose, methods, config.seed))
            print(f"{frame.source}: {found.status}", flush=True)
            yield frame, found

    table = detection_table(looked(), settings)
    table.insert(0, "dataset", name)
    table.insert(1, "split", arguments.coco or "labelled")
    by_method = mask_table(mask_rows(masks))
    print("\n" + as_text(detection_layout(table)))
    if masks:
        print("\n" + as_text(masks_layout(by_method, name)))
    if arguments.out is not None:
        arguments.out.mkdir(parents=True, exist_ok=True)
        table.to_csv(arguments.out / "detection.csv", index=False, float_format="%.3f")
        table_of_photos = pd.DataFrame(photos)
        table_of_photos.to_csv(arguments.out / "photos.csv", index=False, float_format="%.3f")
        page = labelled_page(shown, name, drawn)
        (arguments.out / "photos.html").write_text(page, encoding="utf-8")
        if masks:
            by_method.to_csv(arguments.out / "masks.csv", index=False, float_format="%.3f")
        print(f"\nwritten to {arguments.out}")
    return 0
