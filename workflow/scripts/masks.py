"""Cut out the object of each frame of a chunk in every way, and compare with its labelled mask."""

from pathlib import Path

from chunk_job import logged

from hoi.artifacts import Detection, Frame
from hoi.chunks import frame_seed, read_artifacts
from hoi.detect.config import DetectConfig
from hoi.detect.mask_methods import compare_masks, mask_methods, mask_rows
from hoi.detect.stage import DetectStage

identity = snakemake.params.identity
config = DetectConfig(**identity["settings"])
frames = read_artifacts(Frame, snakemake.input.frames)
detections = read_artifacts(Detection, snakemake.input.detections)
with logged(snakemake):
    poses_alone = config.model_copy(update={"masks": "given"})  # the boxes are found already
    stage, methods = DetectStage(poses_alone, Path("resources/models")), mask_methods(config)
    rows = []
    for frame, found in zip(frames, detections, strict=True):
        pose = stage.pose_of(frame, found) if frame.given_object_mask is not None else None
        if pose is not None:
            seed = frame_seed(identity["seed"], frame.frame_id, "masks")
            rows += compare_masks(frame, found, pose, methods, seed)
    mask_rows(rows).to_csv(snakemake.output[0], index=False, float_format="%.4f")
