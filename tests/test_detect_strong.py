"""Stronger models: the adapters at their libraries' APIs, and what `auto` finds.

torchvision, detectron2, mmdet, dfine_seg and segment_anything are stood in for by small modules of
the same names, functions and result types; the ONNX adapter runs a real network.
"""

import sys
import types

import numpy as np
import pytest

from hoi.detect.config import DetectConfig, ModelFiles, StrongConfig
from hoi.detect.labels import COCO80
from hoi.detect.stage import DetectStage
from hoi.detect.strong.instances import InstanceSegmentation, load_instances
from hoi.detect.strong.selection import resolved
from hoi.errors import AssetError
from test_detect_stage import CHAIR_BOX, HEIGHT, PERSON_BOX, WIDTH, filled, frame, keypoints

torch = pytest.importorskip("torch")

#: What every stand-in network sees: a person, a chair, a street sign (no class of COCO's 80).
SCORES = [0.98, 0.91, 0.8]
BOXES = [PERSON_BOX, CHAIR_BOX, (0.0, 0.0, 10.0, 10.0)]
MASKS = np.stack([filled((25, 15, 55, 105)), filled((60, 62, 98, 108)), filled(BOXES[2])])
PERSON, CHAIR = COCO80.index("person"), COCO80.index("chair")


@pytest.fixture
def weights(tmp_path):
    path = tmp_path / "weights.pth"
    torch.save({"layer": torch.ones(2)}, path)
    return str(path)


@pytest.fixture
def settings_file(tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text("MODEL: {}\n")
    return str(path)


def module(monkeypatch, name, **members):
    """Install a stand-in module and its parents."""
    parts = name.split(".")
    for depth in range(1, len(parts) + 1):
        path = ".".join(parts[:depth])
        if path not in sys.modules or depth == len(parts):
            monkeypatch.setitem(sys.modules, path, types.ModuleType(path))
        if depth > 1:
            setattr(sys.modules[".".join(parts[: depth - 1])], parts[depth - 1], sys.modules[path])
    for key, value in members.items():
        setattr(sys.modules[name], key, value)


@pytest.fixture
def torchvision(monkeypatch):
    seen = {}

    class Network:
        def load_state_dict(self, state):
            seen["state"] = state

        def eval(self):
            return self

        def to(self, device):
            seen["device"] = device
            return self

        def __call__(self, images):
            (image,) = images
            seen["image"] = image
            return [
                {
                    "labels": torch.tensor([1, 62, 12]),  # COCO's numbers: 91 with gaps
                    "scores": torch.tensor(SCORES),
                    "boxes": torch.tensor(BOXES),
                    "masks": torch.from_numpy(MASKS[:, None] * 0.9).float(),
                }
            ]

    def maskrcnn_resnet50_fpn_v2(*, weights=None, weights_backbone=None):
        assert weights is None and weights_backbone is None  # nothing is downloaded
        return Network()

    module(
        monkeypatch,
        "torchvision.models.detection",
        maskrcnn_resnet50_fpn_v2=maskrcnn_resnet50_fpn_v2,
    )
    return seen


@pytest.fixture
def detectron2(monkeypatch):
    seen = {}

    class Node(types.SimpleNamespace):
        def merge_from_file(self, path):
            seen["settings"] = path

    def get_cfg():
        return Node(MODEL=Node(ROI_HEADS=Node()))

    class DefaultPredictor:
        def __init__(self, settings):
            seen["model"] = settings.MODEL

        def __call__(self, image):
            seen["image"] = image
            found = types.SimpleNamespace(
                pred_classes=torch.tensor([PERSON, CHAIR]),
                scores=torch.tensor(SCORES[:2]),
                pred_boxes=types.SimpleNamespace(tensor=torch.tensor(BOXES[:2])),
                pred_masks=torch.from_numpy(MASKS[:2]),
            )
            found.to = lambda device: found
            return {"instances": found}

    def add_pointrend_config(settings):
        settings.MODEL.POINT_HEAD = True

    module(monkeypatch, "detectron2.config", get_cfg=get_cfg)
    module(monkeypatch, "detectron2.engine", DefaultPredictor=DefaultPredictor)
    module(monkeypatch, "detectron2.projects")
    sys.modules["detectron2.projects"].point_rend = types.SimpleNamespace(  # type: ignore[attr-defined]
        add_pointrend_config=add_pointrend_config
    )
    return seen


@pytest.fixture
def mmdet(monkeypatch):
    seen = {}

    def init_detector(settings, weights, device):
        seen.update(settings=settings, weights=weights, device=device)
        return "the model"

    def inference_detector(model, image):
        assert model == "the model"
        seen["image"] = image
        return types.SimpleNamespace(
            pred_instances=types.SimpleNamespace(
                labels=torch.tensor([PERSON, CHAIR]),
                scores=torch.tensor(SCORES[:2]),
                bboxes=torch.tensor(BOXES[:2]),
                masks=torch.from_numpy(MASKS[:2]),
            )
        )

    module(
        monkeypatch,
        "mmdet.apis",
        init_detector=init_detector,
        inference_detector=inference_detector,
    )
    return seen


@pytest.fixture
def dfine_seg(monkeypatch):
    seen = {"names": dict(enumerate(COCO80))}

    class Model:
        names = seen["names"]

        def __call__(self, image):
            seen["image"] = image
            if not image.any():  # what the library answers where nothing is over the threshold
                return [{key: torch.empty(0) for key in ("labels", "scores", "boxes")}]
            found = {
                "labels": torch.tensor([PERSON, CHAIR]),
                "scores": torch.tensor(SCORES[:2]),
                "boxes": torch.tensor(BOXES[:2]),
                "masks": torch.from_numpy(MASKS[:2].astype(np.uint8)),
            }
            return [found]

    def load_model(model, task=None, *, conf_thresh, device):
        if "broken" in model:
            raise ValueError("not a D-FINE-seg checkpoint: no 'encoder.input_proj.0*' key")
        seen.update(weights=model, task=task, threshold=conf_thresh, device=device)
        made = Model()
        made.names = seen["names"]
        return made

    module(monkeypatch, "dfine_seg", load_model=load_model)
    return seen


def picture():
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[..., 0] = 255  # red
    return image


def person_pose(image, box, intrinsics):
    from hoi.detect.backends import PersonPose

    flat = np.zeros((21, 3), np.float32)
    return PersonPose(keypoints(within=box), flat, filled(box).astype(np.float32), 0.9)


def loaded(**strong):
    model = load_instances(StrongConfig(**strong))
    assert model is not None
    return model


# -------------------------------------------------------------------------------- the adapters


def check_person_and_chair(model):
    person, chair = model.instances(picture())
    assert (person.label, chair.label) == ("person", "chair")
    assert person.score == pytest.approx(0.98) and chair.box == CHAIR_BOX
    np.testing.assert_array_equal(chair.mask, MASKS[1])


def test_torchvisions_numbers_are_cocos_with_its_gaps(torchvision, weights):
    model = loaded(instances="torchvision", torchvision={"weights": weights})
    check_person_and_chair(model)  # 62 is the chair, 12 nothing
    image = torchvision["image"]
    assert image.shape == (3, HEIGHT, WIDTH) and image.dtype == torch.float32
    assert image[0].min() == 1 and image[1].max() == 0  # red first, in [0, 1]
    assert torchvision["state"].keys() == {"layer"}


def test_every_class_of_coco_has_one_torchvision_number():
    from hoi.detect.strong.torchvision_maskrcnn import COCO91

    assert len(COCO91) == 80 and set(COCO91.values()) == set(COCO80)
    known = {1: "person", 13: "stop sign", 27: "backpack", 33: "suitcase", 62: "chair",
             67: "dining table", 76: "keyboard", 90: "toothbrush"}  # fmt: skip
    assert {number: COCO91[number] for number in known} == known


def test_detectron2_is_asked_in_blue_first_and_without_its_own_threshold(
    detectron2, weights, settings_file
):
    files = {"weights": weights, "settings": settings_file}
    check_person_and_chair(loaded(instances="pointrend", pointrend=files, device="cuda:0"))
    assert detectron2["image"][0, 0].tolist() == [0, 0, 255]
    assert detectron2["settings"] == settings_file
    told = vars(detectron2["model"])
    assert (told["WEIGHTS"], told["DEVICE"], told["POINT_HEAD"]) == (weights, "cuda:0", True)
    assert vars(told["ROI_HEADS"]) == {"SCORE_THRESH_TEST": 0}


def test_mmdet_is_asked_in_blue_first(mmdet, weights, settings_file):
    files = {"weights": weights, "settings": settings_file}
    check_person_and_chair(loaded(instances="rtmdet", rtmdet=files))
    assert mmdet["image"][0, 0].tolist() == [0, 0, 255]
    assert (mmdet["settings"], mmdet["weights"], mmdet["device"]) == (settings_file, weights, "cpu")


def test_dfine_seg_is_asked_in_blue_first_for_masks(dfine_seg, weights, tmp_path):
    model = loaded(instances="dfine_seg", dfine_seg={"weights": weights}, device="cuda:0")
    check_person_and_chair(model)
    assert dfine_seg["image"][0, 0].tolist() == [0, 0, 255]
    told = (dfine_seg["weights"], dfine_seg["task"], dfine_seg["device"])
    assert told == (weights, "segment", "cuda:0") and 0 < dfine_seg["threshold"] <= 0.05
    assert model.instances(np.zeros((HEIGHT, WIDTH, 3), np.uint8)) == []
    broken = str(tmp_path / "broken.pt")
    with pytest.raises(AssetError, match=r"broken\.pt: not D-FINE-seg weights"):
        loaded(instances="dfine_seg", dfine_seg={"weights": broken})


def test_dfine_seg_trained_on_other_classes_brings_their_names(dfine_seg, weights):
    files = {"weights": weights}
    dfine_seg["names"] = {PERSON: "person", CHAIR: "stroller"}
    found = loaded(instances="dfine_seg", dfine_seg=files).instances(picture())
    assert [item.label for item in found] == ["person", "stroller"]
    dfine_seg["names"] = None  # released weights under another file name
    check_person_and_chair(loaded(instances="dfine_seg", dfine_seg=files))


def test_the_stage_takes_boxes_and_masks_of_the_stronger_model(torchvision, weights, tmp_path):
    config = DetectConfig(
        masks="registry",
        keypoints="registry",
        strong=StrongConfig(instances="torchvision", torchvision=ModelFiles(weights=weights)),
    )
    result = DetectStage(config, tmp_path, pose_estimator=person_pose)(frame(), seed=0)
    assert result.person_mask_source == result.object_mask_source == "torchvision"
    np.testing.assert_array_equal(result.object_mask, MASKS[1])
    np.testing.assert_array_equal(result.person_mask, MASKS[0] & ~MASKS[1])
    assert (result.object_label, result.object_score) == ("chair", pytest.approx(0.91))
    sources = {item.source for item in result.candidates}
    assert sources == {"torchvision, whole picture"}


def test_a_box_that_no_instance_has_goes_to_the_other_segmenter():
    model = InstanceSegmentation("model", lambda image: [], 0.05)
    segment = model.object_masks(lambda image, box, pose, seed: (filled(box), "other"))
    pose = person_pose(picture(), PERSON_BOX, None)
    mask, source = segment(picture(), CHAIR_BOX, pose, 0)
    assert source == "other" and mask.any()
    assert model.person_mask(picture(), PERSON_BOX) is None


def test_one_image_is_segmented_once():
    calls = []
    model = InstanceSegmentation("model", lambda image: calls.append(1) or [], 0.05)
    image = picture()
    model.boxes(image), model.person_mask(image, PERSON_BOX)
    assert len(calls) == 1
    model.boxes(picture())
    assert len(calls) == 2


# ----------------------------------------------------------------------------------- from a box


def test_segment_anything_is_asked_with_the_box(monkeypatch, weights):
    seen = {}

    class SamPredictor:
        def __init__(self, model):
            seen["model"] = model

        def set_image(self, image):
            seen["image"] = image

        def predict(self, box, multimask_output):
            assert multimask_output is False
            return filled(tuple(box))[None], np.array([0.9]), None

    class Sam:
        def __init__(self, checkpoint):
            self.checkpoint = checkpoint

        def to(self, device):
            return self

    module(
        monkeypatch,
        "segment_anything",
        SamPredictor=SamPredictor,
        sam_model_registry={"vit_b": Sam},
    )
    segment = from_box(from_box="sam", sam={"weights": weights})
    mask, source = segment(picture(), CHAIR_BOX, None, 0)
    assert source == "sam" and seen["model"].checkpoint == weights
    np.testing.assert_array_equal(mask, filled(CHAIR_BOX))
    assert seen["image"][0, 0].tolist() == [255, 0, 0]
    with pytest.raises(AssetError, match="vit_x"):
        from_box(from_box="sam", sam={"weights": weights, "settings": "vit_x"})


def from_box(**strong):
    from hoi.detect.strong.from_box import load_from_box

    def nothing(image, box, pose, seed):
        return np.zeros(image.shape[:2], bool), "other"

    return load_from_box(StrongConfig(**strong), nothing)


def test_an_onnx_model_sees_the_surroundings_of_the_box_and_its_mask_comes_back(tmp_path):
    onnx = pytest.importorskip("onnx")
    from onnx import TensorProto, helper

    def value(name, *shape):
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    # logit = 2 * red - 1 + 0 * box: red things are the object
    nodes = [
        helper.make_node("Conv", ["image", "kernel", "bias"], ["red"]),
        helper.make_node("ReduceSum", ["box", "axes"], ["sum"], keepdims=1),
        helper.make_node("Mul", ["sum", "zero"], ["nothing"]),
        helper.make_node("Add", ["red", "nothing"], ["logits"]),
    ]
    constants = [
        helper.make_tensor("kernel", TensorProto.FLOAT, (1, 3, 1, 1), [2.0, 0.0, 0.0]),
        helper.make_tensor("bias", TensorProto.FLOAT, (1,), [-1.0]),
        helper.make_tensor("zero", TensorProto.FLOAT, (1,), [0.0]),
        helper.make_tensor("axes", TensorProto.INT64, (1,), [1]),
    ]
    graph = helper.make_graph(
        nodes, "red", [value("image", 1, 3, 64, 64), value("box", 1, 4)],
        [value("logits", 1, 1, 64, 64)], constants,
    )  # fmt: skip
    path = tmp_path / "red.onnx"
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8),
        path,
    )
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    thing = filled((62, 66, 92, 104))
    image[thing] = (250, 10, 10)
    image[:20, :20] = (250, 10, 10)  # red, and far from the box
    segment = from_box(from_box="onnx", onnx={"weights": str(path), "settings": "64"})
    mask, source = segment(image, (60.0, 64.0, 94.0, 106.0), None, 0)
    assert source == "onnx"
    assert (mask & thing).sum() / (mask | thing).sum() > 0.9
    assert not mask[:20, :20].any()
    nothing, source = segment(np.zeros_like(image), (60.0, 64.0, 94.0, 106.0), None, 0)
    assert source == "other" and not nothing.any()


# ---------------------------------------------------------------------------------------- auto


def asked(**strong):
    return resolved(DetectConfig(masks="registry", strong=StrongConfig(**strong))).strong


def test_auto_takes_the_first_model_whose_library_and_files_are_here(
    monkeypatch, torchvision, mmdet, weights, settings_file
):
    libraries = ("torchvision", "mmdet", "cv2")
    monkeypatch.setattr("hoi.detect.strong.selection.importable", lambda name: name in libraries)
    here = {"weights": weights}
    assert asked(instances="auto", torchvision=here).instances == "torchvision"
    both = dict(torchvision=here, rtmdet=here | {"settings": settings_file})
    assert asked(instances="auto", **both).instances == "rtmdet"
    assert asked(instances="auto", rtmdet=here).instances == "none"  # no settings file
    assert asked(instances="auto", pointrend=here).instances == "none"  # no library


def test_other_weights_make_another_configuration(torchvision, weights, tmp_path):
    other = tmp_path / "other.pth"
    torch.save({"layer": torch.zeros(2)}, other)
    first, second = (
        asked(instances="torchvision", torchvision={"weights": str(path)}).torchvision.sha256
        for path in (weights, other)
    )
    assert first and second and first != second
    with pytest.raises(AssetError, match="sha256"):
        asked(instances="torchvision", torchvision={"weights": weights, "sha256": second})


def test_what_is_missing_is_said(monkeypatch, torchvision, weights, tmp_path):
    here = ("torchvision", "cv2")
    monkeypatch.setattr("hoi.detect.strong.selection.importable", lambda name: name in here)
    with pytest.raises(AssetError, match=r"rtmdet.*mmdet is not installed"):
        asked(instances="rtmdet", rtmdet={"weights": weights})
    gone = str(tmp_path / "gone.pth")
    with pytest.raises(AssetError, match=r"no weights file .*gone\.pth"):
        asked(instances="torchvision", torchvision={"weights": gone})
    with pytest.raises(AssetError, match=r"sam.*segment_anything is not installed"):
        asked(from_box="sam", sam={"weights": weights})
    with pytest.raises(AssetError, match="no weights are named"):
        asked(from_box="onnx")
    broken = tmp_path / "broken.pth"
    broken.write_bytes(b"not a checkpoint")
    with pytest.raises(AssetError, match="not readable as torchvision weights"):
        loaded(instances="torchvision", torchvision={"weights": str(broken)})
