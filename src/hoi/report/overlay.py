"""Pictures of what each stage did with one frame, drawn over its photo.

Every function returns a :class:`Panel`. A stage that stopped gives a panel that says which stage
stopped and why, so a failed frame is as readable as a good one.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hoi.artifacts import Artifact, BodyFit, Detection, Frame, Joint, ObjectFit
from hoi.report.colours import rgb
from hoi.report.config import ReportConfig
from hoi.report.raycast import Rays, Surface, camera_rays, orthographic_rays, shoot
from hoi.report.scene import CAMERA_UP, body_colours, of_joint

if TYPE_CHECKING:
    from hoi.exemplars.library import Exemplar

BONES = (
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
    *((f"{side}_shoulder", f"{side}_elbow") for side in ("left", "right")),
    *((f"{side}_elbow", f"{side}_wrist") for side in ("left", "right")),
    *((f"{side}_shoulder", f"{side}_hip") for side in ("left", "right")),
    *((f"{side}_hip", f"{side}_knee") for side in ("left", "right")),
    *((f"{side}_knee", f"{side}_ankle") for side in ("left", "right")),
    *((f"{side}_ankle", f"{side}_toe") for side in ("left", "right")),
    *((f"{side}_ankle", f"{side}_heel") for side in ("left", "right")),
)

NOT_RUN = "did not run for this frame."

Crop = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture of the report.

    Attributes:
        name: detection, body, exemplar_<rank>, joint, side or top.
        title: a few words.
        image: (H, W, 3) uint8 RGB.
        alt: what is to be seen, for those who cannot see it.
        caption: how to read it.
        stopped: empty, or which stage stopped and why; the image then says the same.
    """

    name: str
    title: str
    image: np.ndarray
    alt: str
    caption: str = ""
    stopped: str = ""


def frame_overlays(
    frame: Frame,
    detection: Detection | None,
    body: BodyFit | None,
    objects: ObjectFit | None,
    joint: Joint | None,
    body_faces: np.ndarray,
    exemplars: Mapping[str, Exemplar] | Sequence[Exemplar] = (),
    config: ReportConfig | None = None,
    up: np.ndarray = CAMERA_UP,
) -> tuple[Panel, ...]:
    """All panels of one frame and one method, in the order of the stages.

    Args:
        frame .. joint: artifacts; None for a stage that did not run, any status is welcome.
        body_faces: (F, 3) of the body model.
        exemplars: the category's exemplars, by name or in a row.
        up: (3,) against gravity in the camera frame, for the views from the side and from above.

    Returns detection, body, exemplar_1.., joint, side, top.
    """
    config = config or ReportConfig()
    return (
        detection_panel(frame, detection, config),
        body_panel(frame, detection, body, body_faces, config),
        *exemplar_panels(frame, detection, objects, exemplars, config),
        *joint_panels(frame, detection, joint, body_faces, config, up),
    )


def detection_panel(frame: Frame, detection: Detection | None, config: ReportConfig) -> Panel:
    """The whole photo with boxes, mask outlines and keypoints."""
    import cv2

    name, title = "detection", "Detection"
    if frame.image is None:
        return stopped_panel(name, title, frame, "frame", config)
    full = (0.0, 0.0, float(frame.image.shape[1]), float(frame.image.shape[0]))
    canvas, scale = _photo(frame.image, full, config.image_width)
    if detection is None or not _drawable(detection):
        reason = _reason(detection, "detect")
        return Panel(name, title, canvas, f"The photo. {reason}", "", reason)
    thick = max(1, round(config.image_width / 320))
    for mask, box, colour in (
        (detection.person_mask, detection.person_box, rgb(config.person_line_colour)),
        (detection.object_mask, detection.object_box, rgb(config.object_line_colour)),
    ):
        if mask is not None:
            _outline(canvas, mask, full, colour, thick)
        if box is not None:
            x0, y0, x1, y1 = (int(v) for v in np.round(box * scale))
            cv2.rectangle(canvas, (x0, y0), (x1, y1), colour, 1, cv2.LINE_AA)
    if detection.keypoints is not None:
        _skeleton(canvas, detection.keypoints, scale, config)
    seen = (
        int((detection.keypoints[:, 2] > config.keypoint_confidence).sum())
        if (detection.keypoints is not None)
        else 0
    )
    alt = (
        f"Photo with the person (blue) and the {frame.category} (orange) outlined and "
        f"{seen} keypoints"
    )
    return Panel(
        name,
        title,
        canvas,
        alt,
        f"Boxes and mask outlines: person blue, {frame.category} orange. Keypoints green, hollow "
        f"below confidence {config.keypoint_confidence:g}.",
        "" if detection.ok else _reason(detection, "detect"),
    )


def close_up(frame: Frame, detection: Detection | None, config: ReportConfig) -> Panel:
    """The detection's panel cut to person and object as the other panels are."""
    if frame.image is None:
        return detection_panel(frame, detection, config)
    whole = detection_panel(
        frame, detection, config.model_copy(update={"image_width": frame.image.shape[1]})
    )
    crop = region_of_interest(frame, detection, config)
    return replace(whole, image=_photo(whole.image, crop, config.image_width)[0])


def labelled_panel(frame: Frame, detection: Detection, config: ReportConfig) -> Panel:
    """The detection's panel with the outline of the object's labelled mask in white."""
    panel = detection_panel(frame, detection, config)
    if frame.image is None or frame.given_object_mask is None:
        return panel
    canvas = panel.image.copy()
    whole = (0.0, 0.0, float(frame.image.shape[1]), float(frame.image.shape[0]))
    thick = max(1, round(config.image_width / 320))
    _outline(canvas, frame.given_object_mask, whole, (0, 0, 0), thick + 2)
    _outline(canvas, frame.given_object_mask, whole, rgb(config.label_line_colour), thick)
    return replace(panel, image=canvas, alt=f"{panel.alt}; the labelled {frame.category} in white")


def body_panel(
    frame: Frame,
    detection: Detection | None,
    body: BodyFit | None,
    body_faces: np.ndarray,
    config: ReportConfig,
) -> Panel:
    """The fitted body over the photo, cropped to person and object."""
    name, title = "body", "Body fit"
    if frame.image is None or frame.intrinsics is None:
        return stopped_panel(name, title, frame, "frame", config)
    crop = region_of_interest(frame, detection, config)
    canvas, scale = _photo(frame.image, crop, config.image_width)
    if body is None or not body.ok or body.vertices is None:
        return stopped_panel(name, title, body, "smplify", config, backdrop=canvas)
    surface = Surface(body.vertices, body_faces, np.array(rgb(config.body_colour)), smooth=True)
    canvas = _draw_over(canvas, [surface], frame.intrinsics, crop, config)
    if detection is not None and detection.keypoints is not None:
        shifted = detection.keypoints - np.array([crop[0], crop[1], 0.0], np.float32)
        _skeleton(canvas, shifted, scale, config)
    error = body.reprojection_error_px
    note = f" Reprojection error {error:.1f} px." if error is not None else ""
    return Panel(
        name,
        title,
        canvas,
        f"The fitted body drawn over the photo.{note}",
        f"Fitted body over the photo with the detected keypoints.{note}",
    )


def exemplar_panels(
    frame: Frame,
    detection: Detection | None,
    objects: ObjectFit | None,
    exemplars: Mapping[str, Exemplar] | Sequence[Exemplar],
    config: ReportConfig,
) -> tuple[Panel, ...]:
    """The best exemplars at their fitted pose, each over the photo with the mask's outline."""
    title = "Exemplars"
    if frame.image is None or frame.intrinsics is None:
        return (stopped_panel("exemplar_1", title, frame, "frame", config),)
    crop = region_of_interest(frame, detection, config, whole_person=False)
    canvas, _ = _photo(frame.image, crop, config.tile_width)
    if objects is None or not objects.ok:
        backdrop, _ = _photo(frame.image, crop, config.image_width)
        return (
            stopped_panel("exemplar_1", title, objects, "objectfit", config, backdrop=backdrop),
        )
    assert objects.exemplars is not None and objects.ious is not None
    assert objects.rotations is not None and objects.translations is not None
    library = _by_name(exemplars)
    panels = []
    for rank, name in enumerate(objects.exemplars[: config.max_exemplars]):
        exemplar = library.get(name)
        iou = float(objects.ious[rank])
        tile = canvas.copy()
        missing = "" if exemplar is not None else f"{name} is not in the exemplar library given"
        if exemplar is not None:
            placed = exemplar.vertices @ objects.rotations[rank].T + objects.translations[rank]
            surface = Surface(placed, exemplar.faces, np.array(rgb(config.object_colour)))
            tile = _draw_over(tile, [surface], frame.intrinsics, crop, config)
        if detection is not None and detection.object_mask is not None:
            _outline(tile, detection.object_mask, crop, rgb(config.person_line_colour), 1)
        panels.append(
            Panel(
                f"exemplar_{rank + 1}",
                f"{rank + 1}. IoU {iou:.2f}",
                tile,
                f"Exemplar {name} at its fitted pose over the photo, silhouette IoU {iou:.2f}",
                name,
                missing,
            )
        )
    return tuple(panels)


def joint_panels(
    frame: Frame,
    detection: Detection | None,
    joint: Joint | None,
    body_faces: np.ndarray,
    config: ReportConfig,
    up: np.ndarray = CAMERA_UP,
) -> tuple[Panel, Panel, Panel]:
    """The final scene over the photo, from the side and from above (`up`: against gravity)."""
    names = (("joint", "Result"), ("side", "From the side"), ("top", "From above"))
    blank = frame.image is None or frame.intrinsics is None
    if blank or joint is None or not joint.ok:
        cause, stage = (frame, "frame") if blank else (joint, "joint")
        first, second, third = (stopped_panel(n, t, cause, stage, config) for n, t in names)
        return first, second, third
    assert joint is not None
    over, (body, thing) = _result_over_photo(frame, detection, joint, body_faces, config)
    who = f"the body and the {frame.category}"
    if joint.method:
        who += f" placed by {joint.method}"
    near, far = config.contact_near_m * 100, config.contact_far_m * 100
    grid = f"Grid {config.view_grid_m:g} m."
    return (
        Panel(
            *names[0],
            over,
            f"Photo with {who} drawn over it",
            f"The nearer surface hides the farther. Skin reddens from {far:g} cm to {near:g} cm "
            f"from the object.",
        ),
        Panel(
            *names[1],
            _side_view([body, thing], config, up),
            f"Side view of {who}",
            f"Camera on the left. {grid}",
        ),
        Panel(
            *names[2],
            _top_view([body, thing], config, up),
            f"View from above of {who}",
            f"Camera at the bottom. {grid}",
        ),
    )


def overlay_sheet(panels: Sequence[Panel], columns: int = 3, gap: int = 8) -> np.ndarray:
    """All panels on one white sheet (H, W, 3) uint8, row by row, each at the first's width."""
    import cv2

    width = panels[0].image.shape[1]
    tiles = [
        cv2.resize(
            panel.image,
            (width, round(panel.image.shape[0] * width / panel.image.shape[1])),
            interpolation=cv2.INTER_AREA,
        )
        for panel in panels
    ]
    rows = [tiles[start : start + columns] for start in range(0, len(tiles), columns)]
    heights = [max(tile.shape[0] for tile in row) for row in rows]
    across = min(columns, len(tiles))
    sheet = np.full(
        (sum(heights) + gap * (len(rows) + 1), across * width + gap * (across + 1), 3),
        255,
        np.uint8,
    )
    top = gap
    for row, height in zip(rows, heights, strict=True):
        for column, tile in enumerate(row):
            left = gap + column * (width + gap)
            sheet[top : top + tile.shape[0], left : left + width] = tile
        top += height + gap
    return sheet


def overview(panels: Sequence[Panel], width: int = 1600) -> np.ndarray:
    """The way from photo to scene on one titled sheet (H, W, 3) uint8, three panels a row.

    Args:
        panels: of :func:`frame_overlays`; the exemplars are put together in one cell.
        width: of the sheet, pixels.
    """
    named = {panel.name: panel.image for panel in panels}
    tiles = [panel.image for panel in panels if panel.name.startswith("exemplar_")]
    size = named["body"].shape[1], named["body"].shape[0]
    cells = (
        ("1  The photo: person, object, keypoints", named["detection"]),
        ("2  A body fitted to the keypoints", named["body"]),
        ("3  Exemplars fitted to the outline", _tiled(tiles, size)),
        ("4  The result: both, where they touch", named["joint"]),
        ("The result from the side", named["side"]),
        ("The result from above", named["top"]),
    )
    gap = width // 100
    across = (width - 4 * gap) // 3
    down, title = across * 3 // 4, across // 14
    sheet = np.full((2 * (title + down + gap) + gap, width, 3), 255, np.uint8)
    for place, (text, image) in enumerate(cells):
        top = gap + place // 3 * (title + down + gap)
        left = gap + place % 3 * (across + gap)
        sheet[top : top + title, left : left + across] = _line(text, across, title)
        sheet[top + title : top + title + down, left : left + across] = _fitted(
            image, (across, down)
        )
    return sheet


def frame_thumbnail(
    frame: Frame,
    detection: Detection | None,
    joint: Joint | None,
    body_faces: np.ndarray,
    config: ReportConfig | None = None,
) -> np.ndarray | None:
    """The picture of a gallery card, `thumbnail_width` wide; None without a photo.

    The result over the photo where there is one, else the photo with what was detected.
    """
    config = config or ReportConfig()
    small = config.model_copy(update={"image_width": config.thumbnail_width})
    if frame.image is None:
        return None
    if joint is not None and joint.ok and frame.intrinsics is not None:
        return _result_over_photo(frame, detection, joint, body_faces, small)[0]
    if detection is not None and _drawable(detection):
        return detection_panel(frame, detection, small).image
    whole = (0.0, 0.0, float(frame.image.shape[1]), float(frame.image.shape[0]))
    return _photo(frame.image, whole, config.thumbnail_width)[0]


def thumbnail(panels: Sequence[Panel], config: ReportConfig | None = None) -> np.ndarray:
    """A card's picture from panels already drawn: the result's if there is one, else the first."""
    import cv2

    config = config or ReportConfig()
    named = {panel.name: panel for panel in panels}
    chosen = named.get("joint")
    if chosen is None or chosen.stopped:
        chosen = named.get("detection", panels[0])
    height, width = chosen.image.shape[:2]
    size = (config.thumbnail_width, max(1, round(height * config.thumbnail_width / width)))
    return cv2.resize(chosen.image, size, interpolation=cv2.INTER_AREA)


def jpeg(image: np.ndarray, quality: int) -> bytes:
    """JPEG bytes of an RGB picture; the same picture gives the same bytes."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=quality, optimize=True)
    return buffer.getvalue()


def webp(image: np.ndarray, quality: int) -> bytes:
    """WebP bytes of an RGB picture; the same picture gives the same bytes."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "WEBP", quality=quality, method=4)
    return buffer.getvalue()


def stopped_panel(
    name: str,
    title: str,
    cause: Artifact | None,
    stage: str,
    config: ReportConfig,
    backdrop: np.ndarray | None = None,
) -> Panel:
    """A panel that says which stage stopped and why, over a faded photo or plain grey."""
    from PIL import Image, ImageDraw, ImageFont

    text = _reason(cause, stage)
    if backdrop is None:
        backdrop = np.full((config.image_width * 3 // 4, config.image_width, 3), 236, np.uint8)
    faded = (0.25 * backdrop + 0.75 * 240).astype(np.uint8)
    picture = Image.fromarray(faded)
    size = max(12, faded.shape[1] // 30)
    font = ImageFont.load_default(size)
    ImageDraw.Draw(picture).multiline_text(
        (size, size), _wrap(text, font, faded.shape[1] - 2 * size), (90, 30, 30), font, spacing=6
    )
    return Panel(name, title, np.asarray(picture), f"{title}: {text}", "", text)


def region_of_interest(
    frame: Frame, detection: Detection | None, config: ReportConfig, whole_person: bool = True
) -> Crop:
    """The part of the photo (x0, y0, x1, y1 in pixels) worth looking at.

    The boxes with a margin, widened to 4:3 so that panels align; the whole photo without boxes.
    `whole_person` False keeps to the object.
    """
    assert frame.image is not None
    height, width = frame.image.shape[:2]
    boxes = []
    if detection is not None:
        boxes = [detection.object_box, detection.person_box if whole_person else None]
        boxes = [box for box in boxes if box is not None]
        if not boxes and detection.person_box is not None:
            boxes = [detection.person_box]
    if not boxes:
        return 0.0, 0.0, float(width), float(height)
    low = np.min([box[:2] for box in boxes], axis=0)
    high = np.max([box[2:] for box in boxes], axis=0)
    side = (high - low) * (1 + 2 * config.crop_margin)
    tall = max(side[1], side[0] * 3 / 4, 16.0)
    size = np.array([tall * 4 / 3, tall])
    size *= min(1.0, width / size[0], height / size[1])
    size = np.round(size)
    start = np.round(np.clip((low + high - size) / 2, 0, np.array([width, height]) - size))
    return float(start[0]), float(start[1]), float(start[0] + size[0]), float(start[1] + size[1])


def _result_over_photo(
    frame: Frame,
    detection: Detection | None,
    joint: Joint,
    body_faces: np.ndarray,
    config: ReportConfig,
) -> tuple[np.ndarray, tuple[Surface, Surface]]:
    """The scene over the crop of the photo, and the surfaces of body and object."""
    assert frame.image is not None and frame.intrinsics is not None
    scene = of_joint(joint, body_faces)
    body = Surface(scene.body_vertices, body_faces, body_colours(scene, config), smooth=True)
    thing = Surface(scene.object_vertices, scene.object_faces, np.array(rgb(config.object_colour)))
    crop = region_of_interest(frame, detection, config)
    canvas, _ = _photo(frame.image, crop, config.image_width)
    believed = frame.intrinsics if joint.intrinsics is None else joint.intrinsics
    return _draw_over(canvas, [body, thing], believed, crop, config), (body, thing)


def _reason(cause: Artifact | None, stage: str) -> str:
    if cause is None:
        return f"Stage {stage} {NOT_RUN}"
    where = cause.failed_stage or stage
    detail = f": {cause.detail}" if cause.detail else ""
    return f"Stage {where} stopped: {cause.status.replace('_', ' ')}{detail}"


def _drawable(detection: Detection) -> bool:
    """Whether a detection, even a failed one, found anything to draw."""
    found = (detection.person_box, detection.object_box, detection.keypoints)
    return detection.ok or any(item is not None for item in found)


def _by_name(exemplars: Mapping[str, Exemplar] | Sequence[Exemplar]) -> Mapping[str, Exemplar]:
    if isinstance(exemplars, Mapping):
        return exemplars
    return {exemplar.name: exemplar for exemplar in exemplars}


def _photo(image: np.ndarray, crop: Crop, width: int) -> tuple[np.ndarray, float]:
    """The crop of a photo resampled to `width`, and picture pixels per photo pixel."""
    import cv2

    x0, y0, x1, y1 = crop
    scale = width / (x1 - x0)
    height = max(1, round((y1 - y0) * scale))
    part = image[int(y0) : int(y1), int(x0) : int(x1)]
    kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return cv2.resize(np.ascontiguousarray(part), (width, height), interpolation=kind), scale


def _outline(
    canvas: np.ndarray, mask: np.ndarray, crop: Crop, colour: tuple[int, int, int], thick: int
) -> None:
    import cv2

    x0, y0, x1, y1 = crop
    part = mask[int(y0) : int(y1), int(x0) : int(x1)].astype(np.float32)
    size = (canvas.shape[1], canvas.shape[0])
    small = cv2.resize(part, size, interpolation=cv2.INTER_AREA) > 0.5
    contours, _ = cv2.findContours(small.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(canvas, contours, -1, colour, thick, cv2.LINE_AA)


def _skeleton(
    canvas: np.ndarray, keypoints: np.ndarray, scale: float, config: ReportConfig
) -> None:
    import cv2

    from hoi.body.keypoints import KEYPOINT

    colour = rgb(config.keypoint_colour)
    points = np.round(keypoints[:, :2] * scale).astype(int)
    sure = keypoints[:, 2] > config.keypoint_confidence
    radius = max(2, canvas.shape[1] // 190)
    for start, end in BONES:
        a, b = KEYPOINT[start], KEYPOINT[end]
        if max(a, b) < len(points) and sure[a] and sure[b]:
            cv2.line(canvas, points[a].tolist(), points[b].tolist(), colour, 1, cv2.LINE_AA)
    for point, confidence, solid in zip(points.tolist(), keypoints[:, 2], sure, strict=True):
        if confidence > 0:
            cv2.circle(canvas, point, radius, colour, -1 if solid else 1, cv2.LINE_AA)


def _draw_over(
    canvas: np.ndarray,
    surfaces: list[Surface],
    intrinsics: np.ndarray,
    crop: Crop,
    config: ReportConfig,
) -> np.ndarray:
    """Shade the surfaces over a picture of the crop."""
    factor = config.supersampling
    height, width = canvas.shape[:2]
    rays = camera_rays(intrinsics, crop, width * factor, height * factor)
    return _composite(canvas, surfaces, rays, config.overlay_opacity, factor)


def _composite(
    canvas: np.ndarray, surfaces: list[Surface], rays: Rays, opacity: float, factor: int
) -> np.ndarray:
    shot = shoot(surfaces, rays, factor)
    alpha = (opacity * shot.coverage)[..., None]
    return np.round(alpha * shot.colour + (1 - alpha) * canvas).astype(np.uint8)


def _level_axes(up: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit up, the viewing direction made level, and the right of it."""
    up = np.asarray(up, float) / np.linalg.norm(up)
    ahead = np.array([0.0, 0.0, 1.0]) - up[2] * up
    ahead /= np.linalg.norm(ahead)
    return up, ahead, np.cross(ahead, up)


def _side_view(surfaces: list[Surface], config: ReportConfig, up: np.ndarray) -> np.ndarray:
    """Parallel view against the camera's right: depth grows to the right, gravity is down."""
    up, ahead, _ = _level_axes(up)
    return _parallel_view(surfaces, ahead, up, config)


def _top_view(surfaces: list[Surface], config: ReportConfig, up: np.ndarray) -> np.ndarray:
    """Parallel view from above: the camera's right is right, depth grows upwards."""
    _, ahead, right = _level_axes(up)
    return _parallel_view(surfaces, right, ahead, config)


def _parallel_view(
    surfaces: list[Surface], right: np.ndarray, up: np.ndarray, config: ReportConfig
) -> np.ndarray:
    factor = config.supersampling
    width = config.image_width
    height = width * 3 // 4
    points = np.concatenate([surface.vertices for surface in surfaces])
    across, upward = points @ right, points @ up
    need = 1.15 * max(np.ptp(across), np.ptp(upward) * width / height)
    span = float(np.clip(need, config.view_span_m, config.max_view_span_m))
    span_up = span * height / width
    if need > span:  # keep the person in the picture when the object is far away
        across, upward = surfaces[0].vertices @ right, surfaces[0].vertices @ up
    middle = (across.max() + across.min()) / 2, (upward.max() + upward.min()) / 2
    centre = middle[0] * right + middle[1] * up
    canvas = _grid(middle, (span, span_up), width, height, config.view_grid_m)
    rays = orthographic_rays(centre, right, up, (span, span_up), width * factor, height * factor)
    return _composite(canvas, surfaces, rays, 1.0, factor)


def _grid(
    middle: tuple[float, float], span: tuple[float, float], width: int, height: int, step: float
) -> np.ndarray:
    """White paper with thin lines every `step` metres."""
    canvas = np.full((height, width, 3), 251, np.uint8)
    left, top = middle[0] - span[0] / 2, middle[1] + span[1] / 2
    columns = np.arange(np.ceil(left / step), np.floor((left + span[0]) / step) + 1) * step
    rows = np.arange(np.ceil((top - span[1]) / step), np.floor(top / step) + 1) * step
    x = np.clip(((columns - left) / span[0] * width).astype(int), 0, width - 1)
    y = np.clip(((top - rows) / span[1] * height).astype(int), 0, height - 1)
    canvas[:, x] = 226
    canvas[y, :] = 226
    return canvas


def _fitted(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The picture scaled into (width, height), centred on white."""
    import cv2

    scale = min(size[0] / image.shape[1], size[1] / image.shape[0])
    inner = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
    kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    canvas = np.full((size[1], size[0], 3), 255, np.uint8)
    left, top = (size[0] - inner[0]) // 2, (size[1] - inner[1]) // 2
    canvas[top : top + inner[1], left : left + inner[0]] = cv2.resize(
        image, inner, interpolation=kind
    )
    return canvas


def _tiled(tiles: Sequence[np.ndarray], size: tuple[int, int]) -> np.ndarray:
    """The first four pictures in two rows, or one alone, in a picture of (width, height)."""
    if len(tiles) < 2:
        return _fitted(tiles[0], size)
    gap = max(2, size[0] // 100)
    width, height = (size[0] - gap) // 2, (size[1] - gap) // 2
    canvas = np.full((size[1], size[0], 3), 255, np.uint8)
    for place, tile in enumerate(tiles[:4]):
        top, left = place // 2 * (size[1] - height), place % 2 * (size[0] - width)
        canvas[top : top + height, left : left + width] = _fitted(tile, (width, height))
    return canvas


def _line(text: str, width: int, height: int) -> np.ndarray:
    """One line of dark text on white."""
    from PIL import Image, ImageDraw, ImageFont

    picture = Image.new("RGB", (width, height), "white")
    font = ImageFont.load_default(round(height * 0.55))
    ImageDraw.Draw(picture).text((0, height * 0.42), text, (31, 35, 40), font, anchor="lm")
    return np.asarray(picture)


def _wrap(text: str, font, width: int) -> str:
    """Break `text` at spaces so that no line is wider than `width` pixels."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if font.getlength(longer) <= width or not lines[-1]:
            lines[-1] = longer
        else:
            lines.append(word)
    return "\n".join(lines)
