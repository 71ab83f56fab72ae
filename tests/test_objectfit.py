"""The object fit: known poses come back, occluded or not, the same every time."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from hoi.artifacts import Detection, Frame
from hoi.config import load_config
from hoi.errors import AssetError, FrameFailure
from hoi.exemplars import Exemplar, save_library
from hoi.geometry import project, rotation_angle, upright_rotations
from hoi.objectfit import search
from hoi.objectfit.config import ObjectFitConfig, Schedule
from hoi.objectfit.search import distinct
from hoi.objectfit.stage import ObjectFitStage, medoid
from hoi.objectfit.starts import align_to_boxes, start_boxes, start_rotations, support_vertices
from hoi.rendering import SilhouetteTarget, depth_map

K = np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]])
HEIGHT, WIDTH = 240, 320
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def boxes(name, *parts):
    """An exemplar of boxes (size, centre); its bounding box is centred."""
    unit = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    triangles = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])
    vertices = np.concatenate([unit * size + centre for size, centre in parts])
    faces = np.concatenate([triangles + 8 * i for i in range(len(parts))])
    vertices -= (vertices.min(0) + vertices.max(0)) / 2
    return Exemplar(name, "chair", vertices, faces, ("chair_seat",), np.zeros(len(faces)))


def chair(name, back=0.5, arm=True, leg=0.45):
    """Seat, back, four legs and one arm, so that no two views of it look alike."""
    parts = [((0.46, 0.06, 0.47), (0, 0, 0)), ((0.44, back, 0.05), (0, back / 2, -0.2))]
    for x in (-0.2, 0.2):
        parts += [((0.05, leg, 0.05), (x, -leg / 2, z)) for z in (-0.19, 0.19)]
    if arm:
        parts += [((0.06, 0.04, 0.4), (0.22, 0.22, 0)), ((0.04, 0.2, 0.05), (0.22, 0.1, 0.17))]
    return boxes(name, *parts)


STOOL = boxes("stool", ((0.4, 0.05, 0.4), (0, 0, 0)), ((0.1, 0.6, 0.1), (0, -0.3, 0)))
CHAIRS = [STOOL, chair("armchair"), chair("low", back=0.2, arm=False), chair("tall", leg=0.7)]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exemplars")
    save_library(CHAIRS, folder / "chair.npz")
    return folder


@pytest.fixture(scope="module")
def stage(library):
    return ObjectFitStage(ObjectFitConfig(num_starts=200), library)


def scene(exemplar, rotation, translation, person=None, name="frame"):
    placed = exemplar.vertices @ rotation.T + translation
    mask = np.isfinite(depth_map(placed, exemplar.faces, K, HEIGHT, WIDTH))
    person = np.zeros_like(mask) if person is None else person
    frame = Frame(
        frame_id=name,
        dataset="test",
        category="chair",
        image=np.zeros((HEIGHT, WIDTH, 3)),
        intrinsics=K,
    )
    detection = Detection(
        frame_id=name,
        person_box=[0, 0, 1, 1],
        object_box=[0, 0, 1, 1],
        person_mask=person,
        object_mask=mask & ~person,
        keypoints=np.zeros((21, 3)),
    )
    return frame, detection


def upright(seed):
    generator = torch.Generator().manual_seed(seed)
    return upright_rotations(1, generator)[0].double().numpy()


def turn_between(first, second):
    return math.degrees(float(rotation_angle(torch.tensor(first), torch.tensor(second))))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_known_pose_comes_back_from_its_own_silhouette(stage, seed):
    rotation, translation = upright(seed), np.array([0.1, -0.05, 2.2])
    fit = stage(*scene(CHAIRS[1], rotation, translation), seed=5)
    assert fit.exemplars[0] == "armchair"
    assert turn_between(fit.rotations[0], rotation) < 5
    assert fit.ious[0] > 0.95
    assert np.abs(fit.translations[0] - translation).max() < 0.08


@pytest.mark.parametrize("seed", [1, 4])
def test_a_person_in_front_is_ignored(stage, seed):
    rotation, translation = upright(seed), np.array([0.0, 0.1, 2.2])
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    person = ((columns - 150) / 22) ** 2 + ((rows - 110) / 70) ** 2 < 1
    frame, detection = scene(CHAIRS[1], rotation, translation, person)
    whole = scene(CHAIRS[1], rotation, translation)[1].object_mask
    assert detection.object_mask.sum() < 0.85 * whole.sum()
    fit = stage(frame, detection, seed=5)
    errors = [
        turn_between(r, rotation)
        for r, name in zip(fit.rotations, fit.exemplars, strict=True)
        if name == "armchair"
    ]
    assert fit.ious[0] > 0.93
    assert min(errors) < 5


def test_rotated_objects_are_found_with_so3_starts(library):
    stage = ObjectFitStage(ObjectFitConfig(init="so3", num_starts=600), library)
    lying = upright(3) @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    fit = stage(*scene(CHAIRS[1], lying, np.array([0, 0, 2.0])), seed=0)
    assert min(turn_between(rotation, lying) for rotation in fit.rotations) < 5
    assert fit.ious[0] > 0.95


def test_one_frame_alone_gives_the_bytes_of_the_whole_run(library, stage):
    first = scene(CHAIRS[1], upright(8), np.array([0.2, 0, 2.5]), name="a")
    second = scene(CHAIRS[3], upright(9), np.array([-0.2, 0, 2.5]), name="b")
    stage(*first, seed=1)
    after_another = stage(*second, seed=2).to_bytes()
    alone = ObjectFitStage(stage.config, library)(*second, seed=2).to_bytes()
    assert after_another == alone
    assert stage(*second, seed=3).to_bytes() != alone


def test_hypotheses_are_ranked_distinct_and_explained(stage):
    fit = stage(*scene(CHAIRS[0], upright(2), np.array([0, 0, 2.0])), seed=0)
    config = stage.config
    assert (np.diff(fit.ious) <= 0).all()
    assert len(set(fit.exemplars)) <= config.top_exemplars
    assert len(fit.reasons) == len(fit.exemplars) == len(fit.losses)
    assert fit.searched == len(CHAIRS) * config.num_starts
    for i, (name, reason) in enumerate(zip(fit.exemplars, fit.reasons, strict=True)):
        assert f"IoU {fit.ious[i]:.3f}" in reason
        for j in range(i):
            if fit.exemplars[j] == name:
                assert turn_between(fit.rotations[i], fit.rotations[j]) >= config.distinct_deg - 0.1
    assert fit.exemplars.count("stool") <= config.poses_per_exemplar
    assert np.allclose(fit.rotations @ fit.rotations.transpose(0, 2, 1), np.eye(3), atol=1e-5)


def test_the_reported_overlap_is_that_of_the_placed_mesh(stage):
    frame, detection = scene(CHAIRS[3], upright(6), np.array([0, 0, 2.4]))
    fit = stage(frame, detection, seed=0)
    exemplar = next(e for e in CHAIRS if e.name == fit.exemplars[0])
    placed = exemplar.vertices @ fit.rotations[0].T + fit.translations[0]
    drawn = np.isfinite(depth_map(placed, exemplar.faces, K, HEIGHT, WIDTH))
    overlap = (drawn & detection.object_mask).sum() / (drawn | detection.object_mask).sum()
    assert overlap == pytest.approx(fit.ious[0], abs=0.04)


def test_a_frame_that_cannot_be_fitted_says_why(stage, tmp_path):
    frame, detection = scene(CHAIRS[1], upright(1), np.array([0, 0, 2.0]))
    empty = detection.model_copy(update={"object_mask": np.zeros((HEIGHT, WIDTH), bool)})
    with pytest.raises(FrameFailure, match="0 object pixels") as failure:
        stage(frame, empty, seed=0)
    assert failure.value.status == "empty_object_mask"
    for field in ("object_mask", "person_mask"):
        wrong = detection.model_copy(update={field: np.ones((9, 9), bool)})
        with pytest.raises(FrameFailure) as failure:
            stage(frame, wrong, seed=0)
        assert failure.value.status == "mask_size_mismatch"
    unknown = frame.model_copy(update={"category": "harp"})
    with pytest.raises(FrameFailure, match="'harp'") as failure:
        stage(unknown, detection, seed=0)
    assert failure.value.status == "no_exemplars"
    (tmp_path / "chair.npz").write_bytes(b"not a library")
    with pytest.raises(AssetError, match="damaged"):
        ObjectFitStage(stage.config, tmp_path)(frame, detection, seed=0)


def test_masks_at_the_border_or_as_large_as_the_photo_do_not_break_it(stage):
    frame, detection = scene(CHAIRS[1], upright(1), np.array([0.9, 0.4, 2.0]))
    assert detection.object_mask[:, -1].any()  # cut by the photo's edge
    fit = stage(frame, detection, seed=0)
    assert fit.ious[0] > 0.7
    full = detection.model_copy(update={"object_mask": np.ones((HEIGHT, WIDTH), bool)})
    assert np.isfinite(stage(frame, full, seed=0).ious).all()


def test_upright_starts_stay_in_their_ranges():
    config = ObjectFitConfig(num_starts=500, yaw_deg=(0, 90), pitch_deg=(0, 20), roll_deg=(-5, 5))
    rotations = start_rotations(config, torch.Generator().manual_seed(0))
    up = rotations[:, :, 1]
    assert (torch.rad2deg(torch.acos(-up[:, 1])) <= 21).all()  # y down: up is -y
    front = torch.atan2(rotations[:, 0, 2], -rotations[:, 2, 2])
    assert torch.rad2deg(front).min() > -5 and torch.rad2deg(front).max() < 95


def test_so3_starts_are_uniform():
    config = ObjectFitConfig(init="so3", num_starts=4000)
    rotations = start_rotations(config, torch.Generator().manual_seed(0))
    assert rotations.mean(0).abs().max() < 0.05
    turned = torch.rad2deg(rotation_angle(rotations, torch.eye(3)))
    below_right_angle = (math.pi / 2 - 1) / math.pi  # of the density (1 - cos a) / pi
    assert (turned < 90).float().mean().item() == pytest.approx(below_right_angle, abs=0.03)


def test_starts_fill_the_box_of_the_mask():
    vertices = CHAIRS[1].vertices
    points = torch.from_numpy(vertices[support_vertices(vertices)])
    rotations = upright_rotations(50, torch.Generator().manual_seed(1))
    want = torch.tensor([[20.0, 14, 40, 52]]).repeat(50, 1)
    camera = np.array([[120.0, 0, 70], [0, 120, -10], [0, 0, 1]])
    shift = align_to_boxes(points, rotations, want, camera)
    xy = project(torch.from_numpy(vertices) @ rotations.transpose(1, 2) + shift[:, None], camera)
    low, high = xy.amin(1), xy.amax(1)
    centre = (want[:, :2] + want[:, 2:]) / 2
    diagonal = (want[:, 2:] - want[:, :2]).norm(dim=1)
    assert ((low + high) / 2 - centre).abs().max() < 1.0
    assert ((high - low).norm(dim=1) / diagonal - 1).abs().max() < 0.05


def test_starts_grow_beyond_the_visible_box_only_when_it_is_cut():
    config = ObjectFitConfig(num_starts=200)
    mask = np.zeros((64, 64))
    mask[20:44, 24:40] = 1
    free = start_boxes(config, SilhouetteTarget(mask), torch.Generator().manual_seed(0))
    assert torch.allclose(free, torch.tensor([24.0, 20, 40, 44]))
    keep = np.ones((64, 64))
    keep[44:] = 0
    cut = start_boxes(config, SilhouetteTarget(mask, keep), torch.Generator().manual_seed(0))
    size = (cut[:, 2:] - cut[:, :2]).norm(dim=1) / (free[0, 2:] - free[0, :2]).norm()
    assert size.min() >= 1 and 1.1 < size.max() <= 1 + config.occluded_growth + 1e-5


def test_distinct_poses_keep_the_better_of_two_near_ones():
    angles = torch.tensor([0.0, 5, 40, 43, 90, 180])
    rotations = torch.eye(3).repeat(6, 1, 1)
    rotations[:, 0, 0] = rotations[:, 1, 1] = torch.cos(torch.deg2rad(angles))
    rotations[:, 1, 0] = torch.sin(torch.deg2rad(angles))
    rotations[:, 0, 1] = -rotations[:, 1, 0]
    assert distinct(rotations, math.radians(20), 10) == [0, 2, 4, 5]
    assert distinct(rotations, math.radians(20), 2) == [0, 2]
    assert distinct(rotations, 0.0, 3) == [0, 1, 2]


def test_the_paper_schedule_is_the_printed_one_and_mistakes_are_named():
    paper = ObjectFitConfig(init="so3", schedule="paper").chosen_schedule.steps
    assert [(s.iterations, s.learning_rate, s.resolution, s.decay) for s in paper] == [
        (50, 1e-3, 256, False)
    ]
    with pytest.raises(ValidationError, match="num_start"):
        ObjectFitConfig(num_start=3)
    with pytest.raises(ValidationError, match="pitch_deg"):
        ObjectFitConfig(pitch_deg=(9, 3))
    with pytest.raises(ValidationError):
        Schedule(steps=())


def test_the_medoid_is_the_shape_most_like_all_others():
    cube = np.random.default_rng(0).uniform(-1, 1, (300, 3))
    shapes = [cube * [1, 1, 3], cube * [1, 1, 1.2], cube, cube * [1, 2.5, 1], cube * [0.9, 1, 1]]
    assert medoid(shapes) == 2


def test_phosas_search_looks_at_one_shape_and_keeps_one_pose():
    config = load_config(Path(__file__).parents[1] / "config" / "config.yaml")
    search = config.objectfit["phosa_calib"]
    assert (search.shapes, search.num_starts, search.top_exemplars) == ("medoid", 2000, 1)
    assert search.chosen_schedule.steps[0].learning_rate == 1e-3
    assert config.objectfit["phosa"].camera == "longest_side"


def released(stage_config, **changes):
    """The released schedule of PHOSA with fewer and coarser steps."""
    step = stage_config.phosa_released.steps[0].model_copy(update=changes)
    return stage_config.model_copy(update={"phosa_released": Schedule(steps=(step,))})


def test_the_released_schedule_of_phosa_descends_from_every_start():
    config = ObjectFitConfig(init="so3", num_starts=2000, schedule="phosa_released")
    step = config.chosen_schedule.steps[0]
    assert (step.poses, step.iterations, step.learning_rate) == (2000, 50, 1e-3)
    assert (step.resolution, step.edge_weight, step.off_screen_weight) == (256, 0.5, 1000.0)


def test_poses_descend_the_same_in_small_groups(library, monkeypatch):
    scene_of = scene(CHAIRS[1], upright(2), np.array([0, 0, 2.0]))
    config = released(
        ObjectFitConfig(num_starts=30, schedule="phosa_released"), resolution=48, iterations=3
    )
    together = ObjectFitStage(config, library)(*scene_of, seed=0).to_bytes()
    monkeypatch.setattr(search, "_MOST_TOGETHER", 30)
    assert ObjectFitStage(config, library)(*scene_of, seed=0).to_bytes() == together


def test_an_object_that_could_face_either_way_is_kept_both_ways(stage):
    """A level camera cannot tell the front of this chair from its back."""
    level = np.diag([1.0, -1, -1])  # facing the camera
    yaw = math.radians(25)
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    away = np.array([[-np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, -np.cos(yaw)]])
    fit = stage(*scene(CHAIRS[3], level @ turn, np.array([0, 0.0, 4.0])), seed=0)
    own = [r for r, name in zip(fit.rotations, fit.exemplars, strict=True) if name == "tall"]
    for side in (level @ turn, level @ away):
        assert min(turn_between(r, side) for r in own) < 15
    assert fit.ious[0] > 0.9


def test_equal_poses_of_a_symmetric_object_stay_separate_hypotheses(stage):
    fit = stage(*scene(STOOL, upright(5), np.array([0, 0, 2.0])), seed=0)
    stools = [i for i, name in enumerate(fit.exemplars) if name == "stool"]
    assert len(stools) == 2
    turned = turn_between(*(fit.rotations[i] for i in stools))
    assert turned > 30
    assert min(fit.ious[i] for i in stools) > 0.95


# ------------------------------------------------------------------------- second mask


def coloured_scene():
    """A red armchair before a grey wall, and a mask that lost its legs and took a piece of wall."""
    frame, detection = scene(CHAIRS[1], upright(1), np.array([0.0, 0.0, 2.2]))
    whole = detection.object_mask
    noise = np.random.default_rng(0).normal(0, 6, (HEIGHT, WIDTH, 3))
    image = np.where(whole[..., None], [190, 50, 40], [140, 145, 150]) + noise
    rows = np.flatnonzero(whole.any(1))
    bad = whole.copy()
    bad[rows[0] + int(0.8 * len(rows)) :] = False
    bad[rows[0] : rows[0] + 25, 150:175] = True
    frame = frame.model_copy(update={"image": np.clip(image, 0, 255).astype(np.uint8)})
    detected = {"object_mask": bad, "object_mask_source": "segmenter"}
    return frame, detection.model_copy(update=detected), whole


def overlap_of(first, second):
    return (first & second).sum() / (first | second).sum()


def test_the_true_outline_as_prior_repairs_a_mask():
    from hoi.objectfit.second_mask import second_mask

    frame, detection, whole = coloured_scene()
    bad, nobody = detection.object_mask, np.zeros_like(whole)
    again = second_mask(frame.image, bad, nobody, whole.astype(np.float32), seed=0)
    assert overlap_of(bad, whole) < 0.9 < 0.97 < overlap_of(again, whole)
    person = np.zeros_like(whole)
    person[:, :150] = True
    assert not (second_mask(frame.image, bad, person, whole.astype(np.float32), 0) & person).any()


def test_the_outline_of_a_fit_is_drawn_where_the_mesh_is(stage):
    from hoi.objectfit.second_mask import best_silhouette

    frame, detection = scene(CHAIRS[1], upright(1), np.array([0.1, -0.05, 2.2]))
    fit = stage(frame, detection, seed=5)
    shapes = stage._shapes("chair")
    placed = CHAIRS[1].vertices @ fit.rotations[0].T + fit.translations[0]
    drawn = best_silhouette(fit, shapes, K, (HEIGHT, WIDTH))
    true = np.isfinite(depth_map(placed, CHAIRS[1].faces, K, HEIGHT, WIDTH))
    assert overlap_of(drawn > 0.5, true) > 0.97


def test_a_second_mask_is_made_of_detected_masks_and_kept_when_it_leaves_less(library, stage):
    config = ObjectFitConfig(num_starts=200, second_mask=True)
    twice = ObjectFitStage(config, library)
    frame, detection, _ = coloured_scene()
    first, second = stage(frame, detection, seed=5), twice(frame, detection, seed=5)
    assert second.ious[0] > first.ious[0]
    given = detection.model_copy(update={"object_mask_source": "given"})
    assert twice(frame, given, seed=5).to_bytes() == first.to_bytes()
