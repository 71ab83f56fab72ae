"""Folders of photos: cameras from EXIF, objects by name, own masks, honest failures."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from hoi.datasets.photos import list_photos, photo_files, read_photo
from hoi.datasets.photos_config import PhotosConfig
from hoi.errors import ConfigError, FrameFailure


def save(path, size=(80, 60), mode="RGB", exif=None, **tags):
    """A photo whose top-left quarter is bright; `tags` go into the EXIF sub-IFD."""
    image = Image.new(mode, size, 0)
    image.paste(Image.new(mode, (size[0] // 2, size[1] // 2), "white"), (0, 0))
    data = Image.Exif()
    data.update(exif or {})
    sub = data.get_ifd(ExifTags.IFD.Exif)
    for name, value in tags.items():
        sub[ExifTags.Base[name]] = value
    image.save(path, exif=data)


def only(folder, **settings):
    config = PhotosConfig(folder=str(folder), **settings)
    (ref,) = list_photos(config)
    return read_photo(config, ref)


def test_a_photo_without_exif_gets_the_stated_field_of_view(tmp_path):
    save(tmp_path / "a.jpg")
    frame = only(tmp_path, default_field_of_view_deg=60)
    assert frame.intrinsics[0, 0] == pytest.approx(40 / math.tan(math.radians(30)))
    assert frame.intrinsics[:2, 2].tolist() == [40, 30]
    assert "assumed" in frame.intrinsics_source
    assert frame.image.shape == (60, 80, 3)


def test_the_film_equivalent_focal_length_is_taken_over_the_diagonal(tmp_path):
    save(tmp_path / "a.jpg", FocalLengthIn35mmFilm=28)
    frame = only(tmp_path)
    assert frame.intrinsics[0, 0] == pytest.approx(28 / math.hypot(36, 24) * 100)
    assert "35 mm" in frame.intrinsics_source


def test_focal_length_and_sensor_resolution_make_pixels(tmp_path):
    save(
        tmp_path / "a.jpg", FocalLength=4.0, FocalPlaneXResolution=500.0,
        FocalPlaneResolutionUnit=3, ExifImageWidth=160, ExifImageHeight=120,
    )  # fmt: skip
    # 500 px a centimetre when taken, half of that in this smaller copy
    assert only(tmp_path).intrinsics[0, 0] == pytest.approx(4.0 * 50 / 2)


@pytest.mark.parametrize("value", [0, 1, 65535])
def test_an_unbelievable_focal_length_is_not_believed(tmp_path, value):
    save(tmp_path / "a.jpg", FocalLengthIn35mmFilm=value)
    assert "assumed" in only(tmp_path).intrinsics_source


def test_orientation_turns_the_picture_upright(tmp_path):
    save(tmp_path / "a.jpg", exif={ExifTags.Base.Orientation: 6})
    frame = only(tmp_path)
    assert frame.image.shape == (80, 60, 3)
    assert frame.image[:35, 35:].mean() > 240  # the bright quarter is at the top right now


def test_large_photos_are_scaled_down_with_their_camera(tmp_path):
    save(tmp_path / "a.png", (400, 300))
    frame = only(tmp_path, max_side=200, default_field_of_view_deg=60)
    assert frame.image.shape == (150, 200, 3)
    assert frame.intrinsics[0, 0] == pytest.approx(100 / math.tan(math.radians(30)))
    assert "400x300" in frame.intrinsics_source


@pytest.mark.parametrize("mode", ["L", "RGBA", "P", "LA", "CMYK"])
def test_every_colour_mode_becomes_rgb(tmp_path, mode):
    image = Image.new("RGB", (40, 30), (200, 100, 50)).convert(mode)
    image.save(tmp_path / ("a.jpg" if mode == "CMYK" else "a.png"))
    assert only(tmp_path).image.shape == (30, 40, 3)


def test_sixteen_bit_grey_is_scaled_and_not_clipped(tmp_path):
    Image.fromarray(np.full((30, 40), 32768, np.uint16)).save(tmp_path / "a.png")
    assert only(tmp_path).image.mean() == pytest.approx(128, abs=1)


def test_objects_are_named_by_config_then_by_file_then_by_folder(tmp_path):
    for name in "abcd":
        save(tmp_path / f"{name}.jpg")
    (tmp_path / "objects.yaml").write_text("a: chair\nb: table\nc: stool\n")
    (tmp_path / "b.yaml").write_text("object: Backpack\nfield_of_view_deg: 90\n")
    config = PhotosConfig(folder=str(tmp_path), objects={"c": "suitcase"})
    refs = list_photos(config)
    assert [ref.category for ref in refs] == ["chair", "backpack", "suitcase", "auto"]
    assert read_photo(config, refs[1]).intrinsics[0, 0] == pytest.approx(40)


def test_notes_say_which_person_and_which_object_in_pixels_of_the_upright_photo(tmp_path):
    save(tmp_path / "a.jpg", (400, 300))
    (tmp_path / "objects.yaml").write_text(
        "a: {object: chair, person: 2, box: [40, 20, 200, 180], person_point: [10, 30]}\n"
    )
    frame = only(tmp_path, max_side=200)
    assert frame.category == "chair"
    assert frame.hints.person == 2
    assert frame.hints.object_box == (20, 10, 100, 90)
    assert frame.hints.person_point == (5, 15)
    assert frame.hints.object_point is None


def test_notes_are_taken_key_by_key_the_runs_configuration_first(tmp_path):
    save(tmp_path / "a.jpg")
    (tmp_path / "objects.yaml").write_text("a: {object: chair, person: 2, point: [1, 1]}\n")
    (tmp_path / "a.yaml").write_text("person: 3\npoint: [2, 2]\n")
    config = PhotosConfig(folder=str(tmp_path), objects={"a": {"point": [3, 3]}})
    (ref,) = list_photos(config)
    notes = ref.notes
    assert (notes.object, notes.person, notes.point) == ("chair", 3, (3, 3))


@pytest.mark.parametrize(
    "said", ["person: 0", "box: [1, 2, 3]", "box: [5, 5, 5, 9]", "point: here", "persn: 1"]
)
def test_notes_that_make_no_sense_are_named_with_photo_and_key(tmp_path, said):
    save(tmp_path / "a.jpg")
    (tmp_path / "objects.yaml").write_text(f"a: {{{said}}}")
    with pytest.raises(ConfigError, match=rf"objects\.yaml: a: .*{said.split(':')[0]}"):
        list_photos(PhotosConfig(folder=str(tmp_path)))


def test_changed_notes_make_the_photo_another_one(tmp_path):
    from hoi.config import load_config
    from hoi.manifest import plan

    shipped = load_config(Path(__file__).parents[1] / "config" / "config.yaml")

    save(tmp_path / "a.jpg")
    digests = set()
    for said in ("chair", "{object: chair, person: 1}", "{object: chair, box: [0, 0, 9, 9]}"):
        (tmp_path / "objects.yaml").write_text(f"a: {said}")
        photos = PhotosConfig(folder=str(tmp_path))
        config = shipped.model_copy(update={"photos": photos, "memo": str(tmp_path / "memo")})
        (chunk,) = plan(config, "photos")
        digests.add(chunk.frames[0].digest)
    assert len(digests) == 3


def test_own_masks_are_read_at_the_stored_size(tmp_path):
    save(tmp_path / "a.jpg", (400, 300))
    mask = Image.new("L", (400, 300), 0)
    mask.paste(255, (0, 0, 200, 300))
    mask.save(tmp_path / "a.person_mask.png")
    frame = only(tmp_path, max_side=200)
    assert frame.given_person_mask.shape == (150, 200)
    assert frame.given_person_mask.mean() == pytest.approx(0.5, abs=0.01)
    assert frame.given_object_mask is None
    config = PhotosConfig(folder=str(tmp_path))
    (ref,) = list_photos(config)
    assert [p.name for p in photo_files(tmp_path, ref)] == ["a.jpg", "a.person_mask.png"]


def test_names_in_other_scripts_and_twins_get_distinct_plain_ids(tmp_path):
    for name in ("été à la mer.jpg", "a.jpg", "a.png", "A.jpeg", "x y.webp"):
        save(tmp_path / name)
    refs = list_photos(PhotosConfig(folder=str(tmp_path)))
    ids = [ref.frame_id for ref in refs]
    assert len({i.lower() for i in ids}) == 5
    assert all(i.replace("_", "").replace(".", "").isalnum() and i.isascii() for i in ids)


@pytest.mark.parametrize("kept", [0, 3, 60, 400])
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_damaged_photos_become_a_status(tmp_path, suffix, kept):
    path = tmp_path / f"a{suffix}"
    noise = np.random.default_rng(0).integers(0, 255, (60, 80, 3), np.uint8)
    Image.fromarray(noise).save(path)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(FrameFailure) as caught:
        only(tmp_path)
    assert caught.value.status == "image_unreadable"


def test_a_mask_of_another_size_is_a_mismatch(tmp_path):
    save(tmp_path / "a.jpg")
    Image.new("L", (5, 5), 255).save(tmp_path / "a.object_mask.png")
    with pytest.raises(FrameFailure) as caught:
        only(tmp_path)
    assert caught.value.status == "mask_size_mismatch"


def test_an_empty_own_mask_is_named(tmp_path):
    save(tmp_path / "a.jpg")
    Image.new("L", (80, 60), 0).save(tmp_path / "a.object_mask.png")
    with pytest.raises(FrameFailure) as caught:
        only(tmp_path)
    assert caught.value.status == "object_mask_empty"


def test_folders_and_files_that_cannot_be_used_are_named(tmp_path):
    with pytest.raises(ConfigError, match="no folder"):
        list_photos(PhotosConfig(folder=str(tmp_path / "absent")))
    with pytest.raises(ConfigError, match="holds no"):
        list_photos(PhotosConfig(folder=str(tmp_path)))
    save(tmp_path / "a.jpg")
    for content in ("objekt: chair", "field_of_view_deg: -3", "focal_px: wide", "- x", "{"):
        (tmp_path / "a.yaml").write_text(content)
        with pytest.raises(ConfigError, match=r"a\.yaml"):
            list_photos(PhotosConfig(folder=str(tmp_path)))
    (tmp_path / "a.yaml").unlink()
    (tmp_path / "objects.yaml").write_text("a: 3")
    with pytest.raises(ConfigError, match=r"objects\.yaml"):
        list_photos(PhotosConfig(folder=str(tmp_path)))


def test_the_example_photos_are_all_named_and_readable():
    config = PhotosConfig()
    refs = list_photos(config)
    assert len(refs) == 6
    assert all(ref.category != "auto" for ref in refs)
    assert all(read_photo(config, ref).ok for ref in refs)


def test_heic_without_its_package_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    (tmp_path / "a.heic").write_bytes(b"not opened")
    with pytest.raises(FrameFailure, match="pip install pillow-heif") as caught:
        only(tmp_path)
    assert caught.value.status == "heic_not_supported"


def test_heic_is_read_like_any_photo(tmp_path):
    heif = pytest.importorskip("pillow_heif", reason="optional: pip install pillow-heif")
    heif.register_heif_opener()
    save(tmp_path / "a.HEIC", FocalLengthIn35mmFilm=28)
    frame = only(tmp_path)
    assert frame.image.shape == (60, 80, 3)
    assert frame.image[:25, :35].mean() > 200 > 50 > frame.image[35:, 45:].mean()
    assert "35 mm" in frame.intrinsics_source


def test_the_users_action_reaches_the_frame(tmp_path):
    save(tmp_path / "a.jpg")
    (tmp_path / "a.yaml").write_text("object: chair\naction: Sit\n")
    assert only(tmp_path).hints.action == "sit"
