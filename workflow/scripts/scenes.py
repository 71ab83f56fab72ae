"""Write what people take away from every frame of a chunk.

Always an overlay picture; where there is a result also the scene as GLB, OBJ and PLY, the body's
parameters, the object's pose and a turntable.
"""

import json
from pathlib import Path

import cv2
from chunk_job import logged
from frame_artifacts import FrameArtifacts

from hoi.report.config import ReportConfig
from hoi.report.exports import turntable, write_object_json, write_smpl_npz
from hoi.report.overlay import frame_overlays, overlay_sheet
from hoi.report.scene import gravity_up, write_scene_glb, write_scene_meshes

MADE = {
    "overlay": "png", "scene": "glb", "obj": "obj", "ply": "ply", "body": "smpl.npz",
    "object": "object.json", "turntable": "turntable.png",
}  # fmt: skip

config = ReportConfig(**snakemake.config.get("report", {}))
index = Path(snakemake.output[0])
folder = index.parent
artifacts = FrameArtifacts(snakemake.input, [snakemake.params.method])
written = {}


def write_picture(path: Path, image) -> None:
    cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


with logged(snakemake):
    for frame_id in artifacts.frame_ids():
        frame, detection = artifacts.frame(frame_id), artifacts.detection(frame_id)
        (view,) = artifacts.views(frame_id)
        paths = {kind: folder / f"{frame_id}.{suffix}" for kind, suffix in MADE.items()}
        for path in paths.values():
            path.unlink(missing_ok=True)
        up = gravity_up(view.joint, view.prior)
        if frame.ok:
            panels = frame_overlays(
                frame,
                detection,
                view.body,
                view.objects,
                view.joint,
                artifacts.faces,
                artifacts.exemplars(frame.category),
                config,
                up,
            )
            write_picture(paths["overlay"], overlay_sheet(panels))
        if frame.image is not None and view.joint is not None and view.joint.ok:
            size = (frame.image.shape[1], frame.image.shape[0])
            write_scene_glb(
                paths["scene"],
                view.joint,
                artifacts.faces,
                config,
                intrinsics=frame.intrinsics,
                image_size=size,
                up=up,
            )
            for kind in ("obj", "ply"):
                write_scene_meshes(paths[kind], view.joint, artifacts.faces, up)
            assert view.body is not None  # there is a result, so there is a body
            write_smpl_npz(paths["body"], view.body, view.joint)
            write_object_json(paths["object"], frame, view.prior, view.joint)
            write_picture(paths["turntable"], turntable(view.joint, artifacts.faces, config, up))
        written[frame_id] = {kind: path.name for kind, path in paths.items() if path.is_file()}
    index.write_text(json.dumps(written, indent=1) + "\n")
