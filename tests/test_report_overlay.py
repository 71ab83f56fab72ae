"""Pictures: the geometry of the rays, what hides what, and stages that stopped."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import report_synthetic as synthetic
from hoi.artifacts import BodyFit, Detection, Frame, Joint, ObjectFit
from hoi.report.colours import linear_from_srgb, rgb
from hoi.report.config import ReportConfig
from hoi.report.overlay import (
    body_panel,
    close_up,
    detection_panel,
    exemplar_panels,
    frame_overlays,
    frame_thumbnail,
    joint_panels,
    overlay_sheet,
    region_of_interest,
    thumbnail,
)
from hoi.report.raycast import (
    Surface,
    camera_rays,
    distance_to_surface,
    orthographic_rays,
    shoot,
    vertex_normals,
)

CONFIG = ReportConfig(image_width=160, tile_width=64, thumbnail_width=48, supersampling=1)
FACES = synthetic.person()[1]


def overlays(**changes):
    values = dict(
        frame=synthetic.frame(),
        detection=synthetic.detection(),
        body=synthetic.body_fit(),
        objects=synthetic.object_fit(),
        joint=synthetic.joint(),
        body_faces=FACES,
        exemplars=synthetic.exemplars(),
        config=CONFIG,
    )
    return frame_overlays(**{**values, **changes})


def quad(x0, y0, x1, y1, z):
    vertices = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]], float)
    return vertices, np.array([[0, 1, 2], [0, 2, 3]])


@given(
    x0=st.floats(0, 300),
    y0=st.floats(0, 200),
    side=st.floats(20, 300),
    focal=st.floats(200, 2000),
)
def test_camera_rays_pass_through_the_pixel_centres_of_the_crop(x0, y0, side, focal):
    intrinsics = np.array([[focal, 0, 300], [0, focal * 1.1, 240], [0, 0, 1]])
    rays = camera_rays(intrinsics, (x0, y0, x0 + side, y0 + side), 8, 4)
    image = rays.directions @ intrinsics.T
    image = image[..., :2] / image[..., 2:]
    np.testing.assert_allclose(image[0, :, 0], x0 + (np.arange(8) + 0.5) * side / 8, atol=1e-6)
    np.testing.assert_allclose(image[:, 0, 1], y0 + (np.arange(4) + 0.5) * side / 4, atol=1e-6)


def test_a_rectangle_covers_exactly_the_pixels_that_its_projection_covers():
    vertices, faces = quad(-0.2, -0.1, 0.3, 0.4, 2.0)
    rays = camera_rays(synthetic.INTRINSICS, (0, 0, 640, 480), 640, 480)
    coverage = shoot([Surface(vertices, faces, np.zeros(3))], rays).coverage
    columns, rows = np.meshgrid(np.arange(640) + 0.5, np.arange(480) + 0.5)
    expected = (np.abs(columns - 332.5) < 62.5) & (np.abs(rows - 277.5) < 62.5)
    np.testing.assert_array_equal(coverage > 0, expected)


def test_supersampling_averages_the_coverage_of_edge_pixels():
    vertices, faces = quad(-0.1, -0.1, 0.1005, 0.1, 1.0)  # right edge at 370.25 pixels
    rays = camera_rays(synthetic.INTRINSICS, (0, 0, 640, 480), 1280, 960)
    coverage = shoot([Surface(vertices, faces, np.zeros(3))], rays, 2).coverage
    assert coverage[240, 369] == 1.0
    assert coverage[240, 370] == pytest.approx(0.5)
    assert coverage[240, 371] == 0.0


def test_the_nearest_surface_wins_whatever_the_order():
    near, faces = quad(-1, -1, 1, 1, 1.0)
    far, _ = quad(-1, -1, 1, 1, 2.0)
    red, blue = np.array([200.0, 0, 0]), np.array([0, 0, 200.0])
    rays = camera_rays(synthetic.INTRINSICS, (300, 220, 340, 260), 4, 4)
    for surfaces in (
        [Surface(near, faces, red), Surface(far, faces, blue)],
        [Surface(far, faces, blue), Surface(near, faces, red)],
    ):
        colour = shoot(surfaces, rays).colour
        assert (colour[..., 0] > 50).all() and (colour[..., 2] == 0).all()


def test_no_surface_gives_an_empty_picture():
    rays = camera_rays(synthetic.INTRINSICS, (0, 0, 640, 480), 8, 6)
    assert shoot([], rays).coverage.sum() == 0


def test_parallel_rays_keep_sizes_and_put_up_on_top():
    vertices, faces = quad(0.0, -0.5, 0.5, 0.0, 3.0)  # right of and above the centre (y down)
    rays = orthographic_rays(
        np.array([0, 0, 3.0]), np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), (2.0, 2.0), 8, 8
    )
    coverage = shoot([Surface(vertices, faces, np.zeros(3))], rays).coverage
    expected = np.zeros((8, 8))
    expected[2:4, 4:6] = 1
    np.testing.assert_array_equal(coverage, expected)


def test_vertex_normals_of_a_sphere_point_away_from_its_centre():
    trimesh = pytest.importorskip("trimesh")
    sphere = trimesh.creation.icosphere(3)
    normals = vertex_normals(sphere.vertices, sphere.faces)
    np.testing.assert_allclose(normals, sphere.vertices, atol=0.02)


@settings(deadline=None, max_examples=20)
@given(st.tuples(*[st.floats(-3, 3)] * 3))
def test_distance_to_a_box_matches_its_closed_form(point):
    vertices, faces = synthetic.boxes(((-0.5, -0.4, -0.3), (0.5, 0.4, 0.3)))
    inside = np.abs(point) - np.array([0.5, 0.4, 0.3])
    outside = np.linalg.norm(np.maximum(inside, 0))
    expected = outside if (inside > 0).any() else -inside.max()
    found = distance_to_surface(np.array([point]), vertices, faces)
    assert found[0] == pytest.approx(expected, abs=1e-5)


def test_srgb_becomes_linear_light_as_in_the_standard():
    np.testing.assert_allclose(
        linear_from_srgb(np.array([0.0, 0.02, 0.5, 1.0])), [0, 0.0015480, 0.2140411, 1], atol=1e-6
    )
    assert rgb("#0a10ff") == (10, 16, 255)


def test_panels_come_in_the_order_of_the_stages():
    names = [panel.name for panel in overlays()]
    assert names == [
        "detection",
        "body",
        *(f"exemplar_{rank}" for rank in range(1, 6)),
        "joint",
        "side",
        "top",
    ]


def test_every_panel_is_an_rgb_picture_with_words_for_those_who_cannot_see_it():
    for panel in overlays():
        assert panel.image.dtype == np.uint8 and panel.image.shape[2] == 3
        assert panel.image.shape[1] in {CONFIG.image_width, CONFIG.tile_width}
        assert panel.alt and panel.title and not panel.stopped


def is_body_coloured(pixel) -> bool:
    return int(pixel[2]) > int(pixel[0])


def test_the_nearer_of_body_and_object_hides_the_other():
    frame, detection = synthetic.frame(), synthetic.detection()
    crop = region_of_interest(frame, detection, CONFIG)
    scale = CONFIG.image_width / (crop[2] - crop[0])
    for z, body_in_front in ((2.2, False), (3.5, True)):
        thing, faces = synthetic.boxes(((-0.2, -0.2, z), (0.2, 0.2, z + 0.1)))
        joint = synthetic.joint().model_copy(update=dict(object_vertices=thing, object_faces=faces))
        result = joint_panels(frame, detection, joint, FACES, CONFIG)[0].image
        row, column = ((240 - crop[1]) * scale, (320 - crop[0]) * scale)
        assert is_body_coloured(result[int(row), int(column)]) == body_in_front


def test_side_and_top_views_show_depth_in_the_stated_direction():
    joint = synthetic.joint(x=-0.2)
    thing, faces = synthetic.boxes(((-0.2, 0.6, 4.0), (0.2, 1.0, 4.4)))  # a metre behind
    joint = joint.model_copy(update=dict(object_vertices=thing, object_faces=faces))
    _, side, top = joint_panels(synthetic.frame(), None, joint, FACES, CONFIG)

    def centre(image, body):
        picture = image.astype(int)
        tinted = (picture[..., 2] - picture[..., 0]) * (1 if body else -1) > 25
        return np.argwhere(tinted).mean(axis=0)

    assert centre(side.image, body=False)[1] > centre(side.image, body=True)[1] + 20
    assert centre(side.image, body=False)[0] > centre(side.image, body=True)[0]  # lower
    assert centre(top.image, body=False)[0] < centre(top.image, body=True)[0] - 20


@pytest.mark.parametrize(
    ("field", "kind", "stage", "panel"),
    [
        ("body", BodyFit, "smplify", "body"),
        ("objects", ObjectFit, "objectfit", "exemplar_1"),
        ("joint", Joint, "joint", "joint"),
        ("detection", Detection, "detect", "detection"),
    ],
)
def test_a_stage_that_stopped_says_so_and_why(field, kind, stage, panel):
    artifact = synthetic.failed(kind, "some_reason", "It was too dark.", stage)
    found = {p.name: p for p in overlays(**{field: artifact})}[panel]
    assert stage in found.stopped and "some reason" in found.stopped
    assert "It was too dark." in found.stopped and found.stopped in found.alt


def test_a_stage_skipped_because_of_an_earlier_one_names_the_earlier_one():
    cause = synthetic.failed(Detection, "no_person", "Nobody there.", "detect")
    panels = overlays(joint=Joint.skipped("f", cause))
    assert {p.name: p for p in panels}["joint"].stopped.startswith("Stage detect stopped")


def test_a_stage_that_did_not_run_says_so():
    assert "did not run" in {p.name: p for p in overlays(body=None)}["body"].stopped


def test_a_frame_without_a_photo_still_gives_every_panel():
    frame = synthetic.failed(Frame, "unreadable_image", "Truncated.", "frame")
    panels = overlays(frame=frame, detection=None, body=None, objects=None, joint=None)
    assert all("unreadable image" in panel.stopped for panel in panels)
    assert frame_thumbnail(frame, None, None, FACES, CONFIG) is None


def test_an_exemplar_that_the_library_lacks_is_named():
    panels = exemplar_panels(
        synthetic.frame(), None, synthetic.object_fit(), synthetic.exemplars()[:1], CONFIG
    )
    assert [bool(panel.stopped) for panel in panels] == [False, True, True, True, True]
    assert "box_chair_3" in panels[3].stopped


def test_the_region_of_interest_holds_the_boxes_and_stays_inside_the_photo():
    frame, detection = synthetic.frame(), synthetic.detection()
    x0, y0, x1, y1 = region_of_interest(frame, detection, CONFIG)
    assert 0 <= x0 <= detection.person_box[0] and 0 <= y0 <= detection.person_box[1]
    assert detection.object_box[2] <= x1 <= 640 and detection.object_box[3] <= y1 <= 480
    assert region_of_interest(frame, None, CONFIG) == (0, 0, 640, 480)


def test_pictures_are_the_same_on_every_run():
    for first, second in zip(overlays(), overlays(), strict=True):
        np.testing.assert_array_equal(first.image, second.image)


def test_a_sheet_holds_all_panels_and_a_thumbnail_shows_the_result():
    panels = overlays()
    sheet = overlay_sheet(panels, columns=5, gap=4)
    assert sheet.shape[1] == 5 * CONFIG.image_width + 6 * 4
    card = thumbnail(panels, CONFIG)
    assert card.shape[1] == CONFIG.thumbnail_width
    direct = frame_thumbnail(
        synthetic.frame(), synthetic.detection(), synthetic.joint(), FACES, CONFIG
    )
    assert direct is not None and direct.shape == card.shape
    assert np.abs(direct.astype(int) - card).mean() < 8


def test_the_card_of_a_failed_frame_shows_its_photo():
    failure = synthetic.failed(Detection, "no_person", "", "detect")
    card = frame_thumbnail(synthetic.frame(), failure, None, FACES, CONFIG)
    photo = synthetic.frame().image
    assert card is not None and photo is not None
    assert card.mean() == pytest.approx(photo.mean(), abs=2)


def test_the_close_up_shows_the_same_part_of_the_photo_as_the_body():
    frame, detection = synthetic.frame(), synthetic.detection()
    whole = detection_panel(frame, detection, CONFIG)
    tight = CONFIG.model_copy(update={"crop_margin": 0.0})
    near = close_up(frame, detection, tight)
    body = body_panel(frame, detection, synthetic.body_fit(), FACES, tight)
    assert near.image.shape == body.image.shape and near.alt == whole.alt

    def width_of_the_outline(image):
        orange = np.abs(image.astype(int) - rgb(CONFIG.object_line_colour)).sum(axis=2) < 60
        return np.ptp(np.flatnonzero(orange.any(axis=0))) + 1

    crop = region_of_interest(frame, detection, tight)
    larger = frame.image.shape[1] / (crop[2] - crop[0])
    grown = width_of_the_outline(near.image) / width_of_the_outline(whole.image)
    assert grown == pytest.approx(larger, rel=0.15) and larger > 1.2
