"""``hoi export-rhobin``: results on BEHAVE as the RHOBIN challenge's ``results.pkl``."""

from __future__ import annotations

import argparse
from pathlib import Path

from hoi.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Which results, and where to write."""
    parser.add_argument("--method", default="ours", help="a method of the tables (default: ours)")
    parser.add_argument("--results", type=Path, default=Path("results/behave"), metavar="FOLDER")
    parser.add_argument("--output", type=Path, default=Path("results/results.pkl"), metavar="FILE")
    parser.add_argument(
        "--config", nargs="+", type=Path, default=[Path("config/config.yaml")], metavar="FILE"
    )
    parser.add_argument(
        "--vertices", action="store_true", help="also the meshes; a large file (100 KB a frame)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the file; 0 when there was a result to write."""
    from hoi.artifacts import BodyFit, Joint
    from hoi.body import DEFAULT_BODY, BodyModel
    from hoi.chunks import Index, artifact_path
    from hoi.config import load_configs
    from hoi.datasets.behave_calibration import sequence_info
    from hoi.datasets.behave_layout import parse_frame_id
    from hoi.datasets.behave_truth import centred_template
    from hoi.evaluate.rhobin import Submission

    config = load_configs(arguments.config)
    if config.behave.kinect != 1:
        raise ConfigError("behave.kinect: the challenge is in the frame of Kinect 1")
    embedded = BodyModel.load(DEFAULT_BODY).identity
    indexes = sorted((arguments.results / "joint" / arguments.method).glob("*.json"))
    indexes = [path for path in indexes if not path.name.endswith(".seconds.json")]
    if not indexes:
        raise ConfigError(f"{arguments.results}: no results of method {arguments.method!r}")
    submission = Submission({}, config.seed, arguments.vertices)
    written = failed = 0
    for index in indexes:
        bodies = arguments.results / "smplify" / index.name
        for frame_id in Index.load(index).frames:
            joint = Joint.load(artifact_path(index, frame_id))
            if not joint.ok:
                failed += 1
                continue
            if joint.body_model == embedded:
                raise ConfigError(
                    "assets.body_model: these results are of the embedded body, whose parameters "
                    "are not SMPL's; the challenge needs results with your SMPL file"
                )
            ref = parse_frame_id(frame_id)
            if ref.object_name not in submission.templates:
                template = centred_template(config.behave_root, ref.object_name)
                submission.templates[ref.object_name] = template
            body = BodyFit.load(artifact_path(bodies, frame_id))
            gender = sequence_info(config.behave_root, ref.sequence).gender
            submission.add(ref.sequence, ref.time, ref.object_name, gender, body, joint)
            written += 1
    if not written:
        raise ConfigError(f"{arguments.results}: none of {failed} frames has a result")
    submission.save(arguments.output)
    total = written + failed
    print(
        f"{arguments.output}: {written} of {total} frames in {len(submission.sequences)} sequences"
        + ("" if written >= 0.975 * total else "; the challenge asks for 97.5 % of its frames")
        + "."
    )
    return 0
