"""Write an overlay picture of every frame of a chunk, and a GLB scene where there is a result."""

import json
from pathlib import Path

import cv2
from chunk_job import logged
from frame_artifacts import FrameArtifacts

from hoi.body import BodyModel
from hoi.report.config import ReportConfig
from hoi.report.overlay import frame_overlays, overlay_sheet
from hoi.report.scene import write_scene_glb

config = ReportConfig(**snakemake.params.identity["settings"])
index = Path(snakemake.output[0])
folder = index.parent
artifacts = FrameArtifacts(snakemake.input, [snakemake.params.method], snakemake.params.frames)
faces = BodyModel.load(Path(snakemake.input.body_model)).faces
written = {}
with logged(snakemake):
    for frame_id in artifacts.frame_ids():
        frame, detection = artifacts.frame(frame_id), artifacts.detection(frame_id)
        (view,) = artifacts.views(frame_id)
        files = {}
        if frame.ok:
            panels = frame_overlays(
                frame,
                detection,
                view.body,
                view.objects,
                view.joint,
                faces,
                artifacts.exemplars(frame.category),
                config,
            )
            files["overlay"] = f"{frame_id}.png"
            sheet = cv2.cvtColor(overlay_sheet(panels), cv2.COLOR_RGB2BGR)
            cv2.imwrite(str(folder / files["overlay"]), sheet)
        glb = folder / f"{frame_id}.glb"
        glb.unlink(missing_ok=True)
        if frame.image is not None and view.joint is not None and view.joint.ok:
            files["scene"] = glb.name
            write_scene_glb(
                glb,
                view.joint,
                faces,
                config,
                intrinsics=frame.intrinsics,
                image_size=(frame.image.shape[1], frame.image.shape[0]),
            )
        written[frame_id] = files
    index.write_text(json.dumps(written, indent=1) + "\n")
