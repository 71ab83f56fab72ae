"""How the object's error of `ours` grows with worse masks, bodies, actions and exemplars.

Run, after ``snakemake results/behave_chair.csv``:
``OMP_NUM_THREADS=1 python benchmarks/sensitivity.py [--results results/...] [--group chair]``

Every row changes one input of the same frames and repeats what follows from it: object fit (masks,
exemplars) and joint stage. Errors under the paper's protocol in cm; the interval is that of the
paired difference to the first row (95 %, bootstrap over frames).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import torch
from measure import rounded, show, write_csv
from rich.progress import track

from hoi.artifacts import (
    Action,
    BodyFit,
    Detection,
    Evaluation,
    Frame,
    GroundTruth,
    ObjectFit,
    Prior,
)
from hoi.body import BodyModel
from hoi.chunks import Index, artifact_path, frame_seed
from hoi.config import load_config
from hoi.errors import FrameFailure
from hoi.evaluate.compare import paired
from hoi.evaluate.stage import EvaluateStage
from hoi.evaluate.tables import evaluation_frame
from hoi.joint.stage import JointStage
from hoi.objectfit.stage import ObjectFitStage
from hoi.priors.stage import PriorStage

ROOT = Path(__file__).parent.parent


@dataclass(frozen=True)
class Inputs:
    """What the joint stage gets of one frame, and the truth."""

    frame: Frame
    truth: GroundTruth
    detection: Detection
    body: BodyFit
    objects: ObjectFit
    prior: Prior
    action: Action


#: Makes one input of a frame worse.
Change = Callable[[Inputs, np.random.Generator], Inputs]


class Bench:
    """The stages of `ours` with the run's configuration, loaded once."""

    def __init__(self, results: Path, exemplars: Path):
        self.config = load_config(ROOT / "config" / "config.yaml")
        self.results, self.exemplars = results, exemplars
        self.body_path = ROOT / self.config.assets.body_model
        self.body_model = BodyModel.load(self.body_path)
        self.joint = {
            action: JointStage(
                self.config.joint_settings("ours").model_copy(update={"action": action}),
                self.body_path,
                exemplars,
            )
            for action in ("hypotheses", "retrieved")
        }
        search = self.config.objectfit[self.config.methods["ours"].search]
        self.search = {
            "library": ObjectFitStage(search, exemplars),
            "medoid": ObjectFitStage(search.model_copy(update={"shapes": "medoid"}), exemplars),
        }
        self.priors = PriorStage(self.config.priors)
        self.evaluate = EvaluateStage(
            self.config.evaluate.model_copy(update={"also": (), "samples": 5000}), self.body_path
        )

    def frames(self, group: str) -> Iterator[Inputs]:
        """Frames of a group whose stages all went well."""
        folders = ("frames", "truth", "detect", "smplify", "objectfit/upright", "priors", "actions")
        kinds = (Frame, GroundTruth, Detection, BodyFit, ObjectFit, Prior, Action)
        for index in sorted(self.results.glob(f"frames/{group}-*[0-9].json")):
            for frame_id in Index.load(index).frames:
                loaded = [
                    kind.load(artifact_path(self.results / folder / index.name, frame_id))
                    for folder, kind in zip(folders, kinds, strict=True)
                ]
                if all(artifact.ok for artifact in loaded):
                    yield Inputs(*loaded)

    def error(self, given: Inputs, mode: str = "hypotheses") -> Evaluation:
        """The evaluation of one frame; raises FrameFailure."""
        seed = frame_seed(self.config.seed, given.frame.frame_id, "joint")
        joint = self.joint[mode](
            given.frame, given.detection, given.body, given.objects, given.prior, seed
        )
        return self.evaluate(frame=given.frame, truth=given.truth, joint=joint, seed=0)

    def refit(self, given: Inputs, shapes: str = "library") -> Inputs:
        """The object fit repeated."""
        seed = frame_seed(self.config.seed, given.frame.frame_id, "objectfit")
        return replace(given, objects=self.search[shapes](given.frame, given.detection, seed))


def noisy_mask(mask: np.ndarray, level: float, rng: np.random.Generator) -> np.ndarray:
    """A detector's mask: the outline moves by up to `level` 1/256 of the object's box, blobs fail.

    Smooth random fields shift the signed distance to the outline; two round bites a level are taken
    from the object or added to it.
    """
    rows, columns = np.nonzero(mask)
    side = max(np.ptp(rows), np.ptp(columns), 8) * 1.6
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    outside = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    field = cv2.resize(
        rng.normal(size=(24, 32)).astype(np.float32),
        mask.shape[::-1],
        interpolation=cv2.INTER_CUBIC,
    )
    noisy = (inside - outside + field * 2 * level * side / 256 > 0).astype(np.uint8)
    for _ in range(int(2 * level)):
        pick = rng.integers(len(rows))
        centre = (int(columns[pick]), int(rows[pick]))
        radius = int(rng.uniform(0.02, 0.05) * side)
        cv2.circle(noisy, centre, radius, int(rng.random() < 0.5), -1)
    return noisy > 0


def with_noisy_mask(bench: Bench, level: float) -> Change:
    def change(given: Inputs, rng: np.random.Generator) -> Inputs:
        assert given.detection.object_mask is not None
        mask = noisy_mask(given.detection.object_mask > 0, level, rng)
        detection = given.detection.model_copy(update={"object_mask": mask})
        return bench.refit(replace(given, detection=detection))

    return change


def with_noisy_body(bench: Bench, degrees: float) -> Change:
    """Noise on every joint and a quarter of it on the global orientation; the pelvis stays."""

    def change(given: Inputs, rng: np.random.Generator) -> Inputs:
        body = given.body
        assert body.global_orient is not None and body.body_pose is not None
        assert body.betas is not None and body.transl is not None and body.joints is not None
        noise = np.radians(degrees)
        pose = body.body_pose + rng.normal(0, noise, 69)
        orient = body.global_orient + rng.normal(0, noise / 4, 3)
        values = [torch.tensor(v[None], dtype=torch.float32) for v in (orient, pose, body.betas)]
        with torch.no_grad():
            posed = bench.body_model(*values)
        shift = body.joints[0] - posed.joints[0, 0].numpy()
        update = {
            "vertices": posed.vertices[0].numpy() + shift,
            "joints": posed.joints[0].numpy() + shift,
        }
        return replace(given, body=body.model_copy(update=update))

    return change


def with_wrong_action(bench: Bench, share: float) -> Change:
    """The true action, and in a share of the frames one that touches otherwise."""

    def change(given: Inputs, rng: np.random.Generator) -> Inputs:
        prior = given.prior
        right = prior.true or prior.retrieved
        assert right is not None
        others = [
            found
            for found in (
                bench.priors.interaction(given.frame.category, other.action)
                for other in given.action.runners_up
            )
            if found.contacts != right.contacts
        ]
        wrong = rng.random() < share
        used = others[rng.integers(len(others))] if wrong and others else right
        return replace(given, prior=prior.model_copy(update={"retrieved": used}))

    return change


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=Path, default=ROOT / "results" / "behave_mini")
    parser.add_argument("--exemplars", type=Path, default=ROOT / "resources" / "exemplars")
    parser.add_argument("--group", default="chair")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    bench = Bench(arguments.results, arguments.exemplars)
    frames = list(bench.frames(arguments.group))

    def same(given: Inputs, _: np.random.Generator) -> Inputs:
        return given

    variants: dict[str, tuple[str, Change]] = {
        "as it is": ("hypotheses", same),
        "masks, noise 1": ("hypotheses", with_noisy_mask(bench, 1)),
        "masks, noise 2": ("hypotheses", with_noisy_mask(bench, 2)),
        "masks, noise 4": ("hypotheses", with_noisy_mask(bench, 4)),
        "body, noise 5 degrees a joint": ("hypotheses", with_noisy_body(bench, 5)),
        "body, noise 10 degrees a joint": ("hypotheses", with_noisy_body(bench, 10)),
        "true actions": ("retrieved", with_wrong_action(bench, 0.0)),
        "30 % wrong actions": ("retrieved", with_wrong_action(bench, 0.3)),
        "all actions wrong": ("retrieved", with_wrong_action(bench, 1.0)),
        "one exemplar, the most typical": (
            "hypotheses",
            lambda given, _: bench.refit(given, "medoid"),
        ),
    }
    first: pd.DataFrame | None = None
    rows = []
    for name, (mode, change) in variants.items():
        found = measured(bench, frames, name, mode, change)
        first = found if first is None else first
        rows.append(row_of(name, found, first, arguments.group))
        show(rows[-1])
    write_csv("sensitivity", rows)


def measured(
    bench: Bench, frames: list[Inputs], name: str, mode: str, change: Change
) -> pd.DataFrame:
    """One row per frame; a frame that fails keeps its reason."""
    evaluations, labels = [], {}
    for given in track(frames, description=name, transient=True):
        frame_id = given.frame.frame_id
        rng = np.random.default_rng(frame_seed(0, frame_id, name))
        try:
            evaluations.append(bench.error(change(given, rng), mode))
        except FrameFailure as failure:
            evaluations.append(Evaluation.failed(frame_id, failure, "joint"))
        labels[frame_id] = {
            "dataset": given.frame.dataset, "category": given.frame.category,
            "action": given.frame.action, "method": name,
        }  # fmt: skip
    return evaluation_frame(evaluations, labels, {})


def row_of(name: str, found: pd.DataFrame, first: pd.DataFrame, group: str) -> dict[str, object]:
    """Mean, median and the paired difference to the first row."""
    errors = found["object_cm"].astype(float).dropna()
    row: dict[str, object] = {
        "input": name,
        "group": group,
        "n": len(errors),
        "failed": len(found) - len(errors),
        "object_mean_cm": rounded(errors.mean()),
        "object_median_cm": rounded(errors.median()),
        "human_mean_cm": rounded(found["human_cm"].astype(float).mean()),
    }
    difference = {"difference_cm": 0.0, "ci_low_cm": 0.0, "ci_high_cm": 0.0}
    if found is not first:
        (pair,) = paired(pd.concat([first, found]), "as it is", group).to_dict("records")
        difference = {key: rounded(pair[key]) for key in difference}
    return row | difference


if __name__ == "__main__":
    main()
