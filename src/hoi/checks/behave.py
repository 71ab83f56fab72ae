"""Sentences about a BEHAVE tree: splits, cameras, scans, frames of every table, truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hoi.checks.behave_frames import ODDITIES, FrameSurvey, survey
from hoi.checks.findings import Finding, few, missing, odd, ok, share, stop
from hoi.config import RunConfig
from hoi.datasets.behave import in_table, split_frames, times_on_disk, with_fits
from hoi.datasets.behave_calibration import (
    calibration_file,
    extrinsics_file,
    read_intrinsics,
    sequence_info,
    world_to_camera,
)
from hoi.datasets.behave_layout import (
    ACTION_GROUPS,
    CATEGORIES,
    OBJECTS,
    TABLE_GROUPS,
    FrameRef,
    frame_ref,
    parse_sequence,
)
from hoi.datasets.behave_truth import template_file
from hoi.errors import ConfigError, FrameFailure

SET, CAMERAS, SCANS, TRUTH = "BEHAVE", "Cameras", "Scans", "Ground truth"
_SPOT_CHECKS = 3  # frames whose truth is really read


class BehaveCheck(NamedTuple):
    """What was found, and the frames of every table after sub-sampling."""

    findings: list[Finding]
    frames: dict[str, list[FrameSurvey]]  # by table group, those that the tables will have


def check_behave(config: RunConfig) -> BehaveCheck:
    """Walk the tree that ``behave.root`` names."""
    root = config.behave_root
    if not root.is_dir():
        return BehaveCheck([stop(SET, f"behave.root: there is no folder {root}.")], {})
    try:
        listed = split_frames(root, config.split, config.behave)
    except ConfigError as error:
        return BehaveCheck([stop(SET, f"{error}.")], {})
    on_disk = [s for s in sorted(listed) if (root / "sequences" / s).is_dir()]
    findings = [*_split(root, config, listed, on_disk)]
    if not on_disk:
        return BehaveCheck(findings, {})
    findings += _cameras(root, on_disk, config.behave.kinect)
    findings += _scans(root, on_disk)
    frames: dict[str, list[FrameSurvey]] = {}
    for group in TABLE_GROUPS:
        try:
            found = _frames(root, config, group, listed)
        except (ConfigError, FrameFailure) as error:
            findings.append(stop(f"Table {group}", f"{error}."))
            continue
        findings += _table(group, found, config)
        frames[group] = [seen for seen in found if seen.listed]
    if not any(frames.values()):
        findings.append(stop(SET, f"No table has a frame in split {config.split!r}."))
    else:
        findings += _truth(root, config, frames)
    return BehaveCheck(findings, frames)


# ------------------------------------------------------------------------------------- the set


def _split(
    root: Path, config: RunConfig, listed: dict, on_disk: Sequence[str]
) -> Iterator[Finding]:
    origin = config.behave.frame_list or "split.json"
    text = (
        f"{root}: {origin} lists {len(listed)} sequences in split {config.split!r}, "
        f"{len(on_disk)} of them are on disk."
    )
    yield (ok if on_disk else stop)(SET, text)
    absent = sorted(set(listed) - set(on_disk))
    if absent and on_disk:
        yield missing(SET, f"Not downloaded: {few(absent)}.")
    dates = sorted({parse_sequence(s)[0] for s in on_disk})
    if config.split == "test" and on_disk and dates != ["Date03"]:
        yield odd(
            SET,
            f"The test split spans {', '.join(dates)}; later papers test on Date03 alone "
            "(behave.dates: [Date03]).",
        )
    outside = Counter(parse_sequence(s)[2] for s in on_disk if not _table_of(s))
    in_no_table = sorted(name for name in outside if name not in CATEGORIES)
    if in_no_table:
        yield ok(SET, f"In no table, as in the paper: {', '.join(in_no_table)}.")
    strange = [s for s in on_disk if parse_sequence(s)[2] not in OBJECTS]
    if strange:
        yield odd(SET, f"Objects that BEHAVE does not have: {few(strange)}.")
    actions = [
        s
        for s in on_disk
        if parse_sequence(s)[2] in CATEGORIES
        and parse_sequence(s)[3] not in ACTION_GROUPS[parse_sequence(s)[2]]
    ]
    if actions:
        yield odd(SET, f"Actions that no table knows, so left out: {few(actions)}.")
    folder = root / "sequences"
    inside = sorted(folder.iterdir()) if folder.is_dir() else []
    extra = [p.name for p in inside if p.is_dir() and not _is_sequence(p.name)]
    if extra:
        yield odd(SET, f"Folders in sequences/ that are no sequences: {few(map(ascii, extra))}.")


def _is_sequence(name: str) -> bool:
    try:
        parse_sequence(name)
    except ValueError:
        return False
    return True


def _table_of(sequence: str) -> str | None:
    return next((group for group in TABLE_GROUPS if in_table(sequence, group)), None)


def _cameras(root: Path, sequences: Sequence[str], kinect: int) -> Iterator[Finding]:
    present, known = [], f"camera k{kinect} is read"
    for camera in range(4):
        path = calibration_file(root, sequences[0], camera)
        try:
            read_intrinsics(path, camera, 2048, 1536)
        except FrameFailure as failure:
            yield (stop if camera == kinect else odd)(CAMERAS, f"{failure.detail}.")
            continue
        if path.is_file():
            present.append(camera)
    if kinect in present:
        names = ", ".join(f"k{camera}" for camera in present)
        yield ok(CAMERAS, f"Intrinsics of {names} are there; {known}, lens distortion ignored.")
    else:
        yield odd(
            CAMERAS, f"No intrinsics of k{kinect}: the published values of BEHAVE's are used."
        )
    if kinect == 1:
        yield ok(CAMERAS, "The world is the frame of k1, so its pose needs no file.")
        return
    for date, sequence in sorted({parse_sequence(s)[0]: s for s in sequences}.items()):
        try:
            world_to_camera(extrinsics_file(root, sequence, kinect))
        except FrameFailure as failure:
            yield stop(CAMERAS, f"No pose of k{kinect} on {date}: {failure.detail}.")


def _scans(root: Path, sequences: Sequence[str]) -> Iterator[Finding]:
    import trimesh

    objects = sorted({parse_sequence(s)[2] for s in sequences} & set(CATEGORIES))
    absent, open_ones, whole = [], [], []
    for name in objects:
        path = template_file(root, name)
        if path is None:
            absent.append(name)
            continue
        try:
            mesh: Any = trimesh.load(path, force="mesh", process=True)
            (whole if mesh.is_watertight else open_ones).append(name)
        except Exception as error:  # the mesh loader raises whatever its parser met
            yield odd(SCANS, f"{path.name} cannot be read: {error!r}.")
    if whole:
        yield ok(SCANS, f"Simplified scans of {', '.join(whole)} are there and watertight.")
    if open_ones:
        yield odd(
            SCANS,
            f"Not watertight: the simplified scans of {', '.join(open_ones)}. Distances do not "
            "mind; inside and outside of such a mesh are not defined.",
        )
    if absent:
        yield missing(
            SCANS,
            f"No simplified scan (objects/<name>/<name>_fNNNN.ply) of {', '.join(absent)}: object "
            "fits without a .ply cannot be placed.",
        )


# ------------------------------------------------------------------------------------- frames


def _frames(root: Path, config: RunConfig, group: str, listed: dict) -> list[FrameSurvey]:
    refs: list[FrameRef] = []
    for sequence in sorted(s for s in listed if in_table(s, group)):
        times = times_on_disk(root, sequence)
        if listed[sequence] is not None:
            times = [time for time in times if time in listed[sequence]]
        refs += [frame_ref(sequence, time) for time in times[:: config.behave.every]]
    if config.behave.fits_30fps:
        refs = with_fits(root, refs, config.behave)
    return survey(root, refs, config.behave)


def _table(group: str, found: list[FrameSurvey], config: RunConfig) -> Iterator[Finding]:
    from hoi.manifest import thinned

    topic = f"Table {group} (results/behave_{group}.csv)"
    usable = [seen for seen in found if seen.listed]
    if not found:
        yield missing(topic, "No frames on disk.")
        return
    kept = thinned([seen.ref for seen in usable], config.frames)
    by_action = Counter(ref.action for ref in kept)
    counts = ", ".join(f"{action} {n}" for action, n in sorted(by_action.items()))
    asked = f" of {len(usable)}" if len(kept) != len(usable) else ""
    if kept:
        yield ok(topic, f"{len(kept)}{asked} frames: {counts}.")
    else:
        yield missing(topic, f"None of {len(found)} frames has both fits.")
    tally = Counter(name for seen in found for name in seen.oddities)
    for name, told in ODDITIES.items():
        if not tally[name]:
            continue
        where = few((s.ref.frame_id for s in found if name in s.oddities), 2)
        text = f"{share(tally[name], len(found))} {told} ({where})."
        # the full masks are a separate download that only the visible share needs
        level = missing if name == "no_full_mask" else odd
        if name == "no_full_mask" and not config.evaluate.min_visible_fraction:
            continue
        yield level(topic, text.replace(" has ", " have ", 1) if tally[name] > 1 else text)


# -------------------------------------------------------------------------------------- truth


def _truth(
    root: Path, config: RunConfig, frames: dict[str, list[FrameSurvey]]
) -> Iterator[Finding]:
    """Read the truth of a few frames: can bodies be matched, and do all conventions agree?"""
    from hoi.body.files import read_body_file
    from hoi.body.topology import topology
    from hoi.datasets.behave import read_frame
    from hoi.datasets.behave_truth import read_ground_truth
    from hoi.errors import HoiError
    from hoi.geometry import project

    refs = [seen.ref for group in frames.values() for seen in group]
    refs = [refs[k * len(refs) // _SPOT_CHECKS] for k in range(min(_SPOT_CHECKS, len(refs)))]
    try:
        body = read_body_file(config.assets.body_model)
    except HoiError:
        return  # told under its own topic
    own = topology(body.faces, len(body.v_template))
    ways: Counter[str] = Counter()
    read = 0
    for ref in refs:
        try:
            frame = read_frame(root, ref, config.behave)
            truth = read_ground_truth(root, ref, config.behave)
        except FrameFailure as failure:
            yield odd(TRUTH, f"{ref.frame_id}: {failure}.")
            continue
        except HoiError as error:
            yield stop(TRUTH, f"{error}.")
            return
        read += 1
        if truth.body_model == own:
            ways["body vertices"] += 1
        elif truth.body_joints is not None:
            ways["24 joints"] += 1
        else:
            ways["none"] += 1
        assert truth.object_vertices is not None and frame.image is not None
        pixels = np.asarray(project(truth.object_vertices, frame.intrinsics))
        inside = ((pixels >= 0) & (pixels < frame.image.shape[1::-1])).all(axis=1).mean()
        if inside < 0.5 or (truth.object_vertices[:, 2] <= 0).any():
            yield odd(
                TRUTH,
                f"{ref.frame_id}: only {inside:.0%} of the true object projects into the picture; "
                f"do calibration and camera (k{config.behave.kinect}) belong together?",
            )
    if not read:
        yield stop(TRUTH, "None of the frames tried has a readable truth.")
    elif ways["none"] == read:
        yield stop(
            TRUTH,
            "The fitted body is no SMPL and true joints are not known, so no frame could be "
            "measured: set behave.smplh to a folder of SMPL-H models, or assets.body_model to an "
            "SMPL file.",
        )
    else:
        named = ", ".join(f"{way} ({n})" for way, n in ways.items() if n)
        yield ok(TRUTH, f"Read in {share(read, len(refs))} tried; bodies are aligned by {named}.")
    if config.behave.smplh:
        yield from _root_convention(root, config, refs)


def _root_convention(root: Path, config: RunConfig, refs: Sequence[FrameRef]) -> Iterator[Finding]:
    """Which convention of `trans` reproduces the stored meshes."""
    from hoi.body.smplh import SmplhModel, smplh_path
    from hoi.datasets.behave_truth import person_parameters, read_mesh
    from hoi.errors import HoiError

    apart: dict[str, list[float]] = {"model": [], "centred": []}
    for ref in refs:
        stem = root / "sequences" / ref.sequence / ref.time / "person" / "fit02" / "person_fit"
        stored, parameters = stem.with_suffix(".ply"), stem.with_suffix(".pkl")
        if not (stored.is_file() and parameters.is_file()):
            continue
        try:
            assert config.behave.smplh is not None
            gender = sequence_info(root, ref.sequence).gender
            model = SmplhModel.load(smplh_path(Path(config.behave.smplh).expanduser(), gender))
            given, mesh = person_parameters(parameters), read_mesh(stored)
        except HoiError as error:
            yield odd(TRUTH, f"{ref.frame_id}: {error}.")
            continue
        for name, distances in apart.items():
            posed = model.pose(given.pose, given.betas, given.trans, name)  # type: ignore[arg-type]
            if posed.vertices.shape == mesh.vertices.shape:
                distances.append(float(np.abs(posed.vertices - mesh.vertices).max()))
    if not apart["model"]:
        return
    best = min(apart, key=lambda name: max(apart[name]))
    millimetres = 1000 * max(apart[best])
    told = (
        f"person_fit.pkl posed under smplh_root {best!r} lies within {millimetres:.1f} mm of "
        f"person_fit.ply ({len(apart[best])} frames)"
    )
    if millimetres > 10:
        yield odd(TRUTH, f"{told}: neither convention reproduces the stored meshes.")
    elif best != config.behave.smplh_root:
        yield odd(TRUTH, f"{told}: set behave.smplh_root: {best}.")
    else:
        yield ok(TRUTH, f"{told}.")


def oddities_csv(frames: dict[str, list[FrameSurvey]]) -> str:
    """One line per frame of the tables: group, frame and its oddities."""
    lines = ["table,frame,action,oddities"]
    for group, found in frames.items():
        lines += [f"{group},{s.ref.frame_id},{s.ref.action},{' '.join(s.oddities)}" for s in found]
    return "\n".join(lines) + "\n"
