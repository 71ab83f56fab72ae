"""Pairs of people and objects on COCO's photos: read from any part of COCO."""

import json

import cv2
import numpy as np
import pytest

from hoi.body.keypoints import KEYPOINT
from hoi.datasets.coco_pairs import PAIRS, coco_pairs, read_coco_pairs
from hoi.detect.labels import label_weights
from hoi.errors import ConfigError

TABLE = "image,subset,person,object,category,split\n"
SQUARE = [[10, 20, 30, 20, 30, 50, 10, 50]]
TRIANGLE = [[40, 10, 60, 10, 60, 40], [1, 1, 5, 1, 5, 5, 1, 5]]


@pytest.fixture
def coco(tmp_path):
    """One photo with a person and a cup, and a table that also names one that is not there."""
    folder = tmp_path / "coco"
    (folder / "annotations").mkdir(parents=True)
    (folder / "val2017").mkdir()
    cv2.imwrite(str(folder / "val2017/000000000007.jpg"), np.full((64, 96, 3), 90, np.uint8))
    outlines = [
        {"id": 71, "segmentation": SQUARE},
        {"id": 72, "segmentation": TRIANGLE},
        {"id": 73, "segmentation": {"counts": [], "size": [64, 96]}},
        {"id": 74, "segmentation": []},
    ]
    write(folder, "instances", outlines)
    table = tmp_path / "pairs.csv"
    table.write_text(
        TABLE
        + "7,val2017,71,72,cup,test\n8,val2017,81,82,cup,test\n9,train2017,91,92,cup,test\n"
        + "7,val2017,71,73,cup,dev\n"
    )
    return folder, table


def write(folder, kind, rows):
    path = folder / "annotations" / f"{kind}_val2017.json"
    path.write_text(json.dumps({"annotations": rows}))


def test_outlines_become_given_masks_and_absent_photos_are_left_out(coco):
    folder, table = coco
    (frame,) = read_coco_pairs(folder, "test", table)
    assert (frame.dataset, frame.category, frame.image.shape) == ("coco", "cup", (64, 96, 3))
    person, thing = frame.given_person_mask, frame.given_object_mask
    assert person[25:45, 12:28].all() and not person[:, 33:].any()
    assert abs(int(person.sum()) - 20 * 30) < 60
    assert thing[12, 56] and thing[3, 3] and not thing[38, 42]  # both polygons, not their box
    assert frame.given_keypoints is None


def test_keypoints_are_cocos_where_the_folder_has_them(coco):
    folder, table = coco
    points = np.zeros((17, 3))
    points[5] = 14, 25, 2  # the left shoulder
    write(folder, "person_keypoints", [{"id": 71, "keypoints": points.reshape(-1).tolist()}])
    (frame,) = read_coco_pairs(folder, "test", table)
    assert frame.given_keypoints[KEYPOINT["left_shoulder"], :2].tolist() == [14, 25]
    assert (frame.given_keypoints[:, 2] > 0).sum() == 1


def test_what_cannot_be_used_is_named(coco, tmp_path):
    folder, table = coco
    with pytest.raises(ConfigError, match="annotation 73 is a crowd"):
        list(read_coco_pairs(folder, "dev", table))
    table.write_text(TABLE + "7,val2017,71,74,cup,test\n")
    with pytest.raises(ConfigError, match="annotation 74 marks no pixel"):
        list(read_coco_pairs(folder, "test", table))
    table.write_text(TABLE + "7,val2017,71,99,cup,test\n")
    with pytest.raises(ConfigError, match="photo 7: there is no annotation 99"):
        list(read_coco_pairs(folder, "test", table))
    with pytest.raises(ConfigError, match="none of the photos"):
        list(read_coco_pairs(tmp_path, "test"))
    (folder / "annotations/instances_val2017.json").unlink()
    with pytest.raises(ConfigError, match=r"instances_val2017\.json: there is no such file"):
        list(read_coco_pairs(folder, "test", table))


DAMAGED = (
    b"", b"[]", b"{}", b"\xff\xfe", b'{"annotations": 3}', b'{"annotations": [1]}',
    b'{"annotations": [{}]}', b'{"annotations": [{"id": 71}, {"id": 72}]}',
    b'{"annotations": [{"id": 71, "segmentation": [["a"]]}, {"id": 72}]}',
    b'{"annotations": [{"id": 71, "segmentation": [[1, 2, 3]]}, {"id": 72}]}',
)  # fmt: skip


@pytest.mark.parametrize("content", DAMAGED)
def test_damaged_annotations_are_an_error_with_the_files_name(coco, content):
    folder, table = coco
    path = folder / "annotations/instances_val2017.json"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="instances_val2017"):
        list(read_coco_pairs(folder, "test", table))


def test_the_table_that_ships_names_things_that_the_detectors_know():
    dev, test = coco_pairs("dev"), coco_pairs("test")
    assert len(dev) == 57 and len(test) == 33
    assert {pair.subset for pair in test} == {"val2017"}
    assert not {pair.image for pair in dev} & {pair.image for pair in test}
    assert all(label_weights(pair.category, {}, 0.5) for pair in dev + test)
    assert len(PAIRS.read_text().splitlines()) == 91
