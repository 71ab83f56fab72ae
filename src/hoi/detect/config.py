"""Every number of the detect stage."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, PositiveFloat, field_validator

from hoi.detect.labels import ANY_CATEGORY, KNOWN, PERSON
from hoi.settings import Settings


class NanoDetConfig(Settings):
    """The box detector of the registry back end."""

    nms_iou: float = Field(
        default=0.6, gt=0, le=1, description="Boxes of one class overlapping more merge."
    )
    floor: float = Field(
        default=0.02,
        gt=0,
        le=1,
        description="Boxes scoring less are not even recorded as candidates.",
    )


class SsdConfig(Settings):
    """The second box detector of the registry back end."""

    nms_iou: float = Field(
        default=0.55, gt=0, le=1, description="Boxes of one class overlapping more merge."
    )
    floor: float = Field(
        default=0.03,
        gt=0,
        le=1,
        description="Boxes scoring less are not even recorded as candidates.",
    )


class LooksConfig(Settings):
    """Where the detectors look again: small networks lose small things in a large picture."""

    around: tuple[PositiveFloat, ...] = Field(
        default=(1.5, 2.0),
        description="Sides of squares around the person / longer side of the person's box.",
    )
    around_small: tuple[PositiveFloat, ...] = Field(
        default=(1.5,), description="The same for small things, which are looked for at the hands."
    )
    hands: tuple[PositiveFloat, ...] = Field(
        default=(0.45, 0.7),
        description="Sides of those squares, around the middle of both hands.",
    )
    small_m: float = Field(
        default=0.6, description="Categories whose longest things are no longer are small."
    )


class EvidenceConfig(Settings):
    """How looks vote for the place of the object, see :mod:`hoi.detect.evidence`."""

    any_class_weight: float = Field(
        default=0.2,
        ge=0,
        le=1,
        description="Weight of a class that does not stand for the category, times its own "
        "doubt: weight x score x (1 - score).",
    )
    faintest: float = Field(default=0.01, gt=0, description="Fainter votes do not count.")
    same_place: float = Field(
        default=0.45, gt=0, le=1, description="Boxes that overlap so much (IoU) are one proposal."
    )
    border: float = Field(
        default=0.02, ge=0, description="A box that ends so near a look's border is cut off there."
    )
    cut_weight: float = Field(default=0.3, ge=0, le=1, description="Factor on its vote.")


class TouchConfig(Settings):
    """How a pose judges a box, see :mod:`hoi.detect.touching`."""

    visible: float = Field(
        default=0.5, ge=0, le=1, description="Confidence of keypoints that give the scale."
    )
    minimum_points: int = Field(default=4, ge=2)
    minimum_spread_m2: float = Field(
        default=0.01, gt=0, description="Summed squares under which landmarks give no scale."
    )
    person_height_m: float = Field(default=1.7, gt=0)
    distance_m: float = Field(
        default=0.2, gt=0, description="At this distance from contact the bonus is down to 1/e."
    )
    far_weight: float = Field(
        default=0.15, gt=0, le=1, description="What is left of it for something out of reach."
    )
    hidden: float = Field(
        default=0.5, gt=0, le=1, description="Things may look this much shorter: partly hidden."
    )
    loose: float = Field(default=1.3, ge=1, description="Boxes may be this much longer.")
    size_tolerance: float = Field(
        default=0.4, gt=0, description="Natural logarithm beyond that at which size counts 1/e."
    )


class BlazePoseConfig(Settings):
    """Keypoints, 3D landmarks and the person mask of the registry back end."""

    complexity: Literal["full", "heavy"] = Field(
        default="heavy",
        description="Landmark model: heavy is right more often, full is three times faster.",
    )
    crop_scale: float = Field(
        default=1.25, gt=1, description="Side of the crop / size of the person."
    )
    wide_scale: float = Field(
        default=2.5,
        gt=1,
        description="The same for who is cut off by the picture's border, or seen by no other "
        "crop: the model expects a whole body, much of which is then missing.",
    )
    wide_shifts: tuple[float, ...] = Field(
        default=(0.0, 0.3, 0.6),
        description="Such crops are centred so far below the box's centre / its longer side: "
        "what is missing is mostly the legs. Empty for none.",
    )
    cut_margin: float = Field(
        default=0.01,
        ge=0,
        description="A box that comes so near the border / its longer side is cut off there.",
    )
    passes: int = Field(
        default=2, ge=1, le=3, description="Passes after the first re-centre the crop."
    )
    minimum_score: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="Presence score under which there is no person in the crop.",
    )
    minimum_inside: float = Field(
        default=0.7,
        ge=0,
        le=1,
        description="A later pass is kept only if this share of its visible keypoints stays in the "
        "person's box; otherwise it has jumped to another person.",
    )
    box_slack: float = Field(
        default=0.15,
        ge=0,
        description="The box is widened by this share of its longer side in that test, "
        "and beyond it the person mask is cut.",
    )
    visible: float = Field(
        default=0.5, ge=0, le=1, description="Confidence of a keypoint that counts as seen."
    )
    mask_threshold: float = Field(default=0.5, gt=0, lt=1)
    threads: int = Field(default=1, ge=1)


class GrabCutConfig(Settings):
    """Object mask from a box, by colour alone."""

    context: float = Field(
        default=0.35, ge=0, description="Surroundings shown, as a share of the box side."
    )
    longest_side: int = Field(default=420, ge=32, description="Pixels the crop is reduced to.")
    iterations: int = Field(default=6, ge=1)
    limb_width: float = Field(
        default=0.035,
        gt=0,
        description="Width of the sure-person skeleton / longer side of the person box.",
    )
    minimum_fill: float = Field(
        default=0.08,
        ge=0,
        le=1,
        description="A result that covers less of its box is distrusted.",
    )
    swallowed: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="Where the person's mask covers this share of the object's box it has "
        "swallowed the object (a worn bag) and is no hint.",
    )


class SegmenterConfig(Settings):
    """Object mask from a box by the network that ships with the package."""

    margin: float = Field(
        default=1.5, ge=1, description="Side of the square shown / longer side of the box."
    )
    threshold: float = Field(default=0.5, gt=0, lt=1, description="Probability of an object pixel.")
    refine: bool = Field(
        default=True,
        description="GrabCut decides on the pixels that the network is unsure of.",
    )
    sure_background: float = Field(
        default=0.2, ge=0, le=0.5, description="Pixels less probable stay out."
    )
    sure_foreground: float = Field(
        default=0.8, ge=0.5, le=1, description="Pixels more probable stay in."
    )
    iterations: int = Field(default=2, ge=1, description="Of GrabCut.")
    longest_side: int = Field(
        default=420, ge=32, description="Pixels GrabCut's crop is reduced to."
    )
    context: float = Field(
        default=0.2, ge=0, description="Surroundings GrabCut sees, as a share of the box side."
    )
    swallowed: float = Field(
        default=0.5,
        ge=0,
        description="A person mask that covers this share of the object's box has swallowed the "
        "object and is withheld from the network (chosen on the tuning split); over 1: never.",
    )
    minimum_fill: float = Field(
        default=0.02,
        ge=0,
        le=1,
        description="Where the network finds less of the box than this, GrabCut alone segments.",
    )


class ResegmentConfig(Settings):
    """Segmenting again from the mask's own box, see :mod:`hoi.detect.resegment`."""

    passes: int = Field(default=3, ge=1, description="Segmentations at most.")
    settled: float = Field(
        default=0.9, gt=0, le=1, description="No more passes once the boxes overlap so much (IoU)."
    )
    least_overlap: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="A mask whose box overlaps less with the box asked with shows another thing.",
    )
    least_area: float = Field(
        default=0.7,
        ge=0,
        le=1,
        description="A mask whose box is smaller than this share of the detector's has missed a "
        "part, and the detector's box stays.",
    )
    smallest_part: float = Field(
        default=0.02, gt=0, le=1, description="Parts with a smaller share of a mask are specks."
    )


class ModelFiles(Settings):
    """Where one stronger model lies. What `settings` means, each model says itself."""

    weights: str = ""
    settings: str = ""
    sha256: str = Field(default="", description="of the weights; checked if given")


class StrongConfig(Settings):
    """Stronger models, if installed: docs/detection.md. ``auto`` takes the first that is here."""

    instances: Literal["none", "auto", "pointrend", "rtmdet", "dfine_seg", "torchvision"] = Field(
        default="none", description="Boxes and masks of people and objects."
    )
    from_box: Literal["none", "auto", "sam", "onnx"] = Field(
        default="none", description="The object's mask from its box."
    )
    device: str = "cpu"
    floor: float = Field(
        default=0.05, gt=0, le=1, description="Instances scoring less are not even recorded."
    )
    pointrend: ModelFiles = ModelFiles()
    rtmdet: ModelFiles = ModelFiles()
    dfine_seg: ModelFiles = ModelFiles()
    torchvision: ModelFiles = ModelFiles()
    sam: ModelFiles = ModelFiles()
    onnx: ModelFiles = ModelFiles()


class DetectConfig(Settings):
    """Section 3.1 (detection) and 4.2 (what counts as detected)."""

    masks: Literal["given", "registry", "prefer_given"] = Field(
        default="given",
        description="given: the data set's own masks, as in the paper's supplementary evaluation; "
        "registry: detect boxes and segment them; prefer_given: detect what has no mask.",
    )
    object_masks: Literal["segmenter", "grabcut"] = Field(
        default="segmenter",
        description="How a detected object's box becomes a mask: by the network that ships with "
        "the package (docs/segmenter.md), or by colour alone.",
    )
    keypoints: Literal["given", "registry"] = "given"
    landmarks: Literal["registry", "none"] = Field(
        default="registry",
        description="3D landmarks of the person that start the body fit. They need the pose model "
        "even where masks and keypoints are given.",
    )

    person_threshold: float = Field(
        default=0.2,
        ge=0,
        le=1,
        description="The paper's PointRend uses 0.9 (section 4.2); the scores of the small "
        "detector used here are lower.",
    )
    object_threshold: float = Field(
        default=0.1,
        ge=0,
        le=1,
        description="The paper: 0.9, and 0.6 as a second try (section 4.2), on the score of one "
        "box. Ours is on the evidence of all looks, and can be low.",
    )
    unnamed_threshold: float = Field(
        default=0.35,
        ge=0,
        le=1,
        description="The same for an object that nobody named: boxes of all classes compete.",
    )
    reported_thresholds: tuple[float, ...] = Field(
        default=(0.9, 0.6),
        description="Thresholds at which failures are counted beside our own (section 4.2).",
    )
    labels: dict[str, tuple[str, ...]] = Field(
        default={},
        description="Detector labels per category, best first; replaces the built-in table's row.",
    )
    secondary_weight: float = Field(
        default=0.5,
        gt=0,
        le=1,
        description="Factor on the score of a look-alike label (couch for chair).",
    )

    require_single_person: bool = Field(
        default=False, description="Fail with several_people instead of choosing one."
    )
    rival_area: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="People whose box is smaller than this share of the largest one's are "
        "background.",
    )
    reach: float = Field(
        default=0.75,
        gt=0,
        description="The gap between the boxes of person and object, in longer sides of the "
        "person's box, at which a pair is too far apart to interact.",
    )

    unused_weight: float = Field(
        default=0.4,
        ge=0,
        le=1,
        description="Factor on the rating of a place that shows nothing of what the network takes "
        "the person to use; 1: it is not asked.",
    )

    max_people: int = Field(
        default=3, ge=1, description="Poses are read of so many people, the plainest ones."
    )

    same_person: float = Field(
        default=0.7,
        gt=0,
        le=1,
        description="Two people's boxes that share this much of the smaller one are one person.",
    )
    same_thing: float = Field(
        default=0.75,
        gt=0,
        le=1,
        description="An object's box that overlaps the person's this much (IoU) may show the "
        "person: a small detector answers surfboard for a surfer.",
    )
    same_thing_weight: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="Factor on the evidence of such a box where the wanted thing was named there "
        "(an armchair and who sits in it); elsewhere it is out.",
    )

    minimum_mask_pixels: int = Field(
        default=16, ge=1, description="Masks with fewer pixels are empty."
    )
    keypoint_threshold: float = Field(
        default=0.3, ge=0, le=1, description="Confidence from which a keypoint counts as found."
    )
    minimum_keypoints: int = Field(
        default=6,
        ge=1,
        description="Frames with fewer found keypoints fail: no body can be fitted to them.",
    )

    resegment: ResegmentConfig = ResegmentConfig()
    strong: StrongConfig = StrongConfig()
    nanodet: NanoDetConfig = NanoDetConfig()
    ssd: SsdConfig = SsdConfig()
    looks: LooksConfig = LooksConfig()
    evidence: EvidenceConfig = EvidenceConfig()
    touch: TouchConfig = TouchConfig()
    blazepose: BlazePoseConfig = BlazePoseConfig()
    grabcut: GrabCutConfig = GrabCutConfig()
    segmenter: SegmenterConfig = SegmenterConfig()

    @field_validator("labels")
    @classmethod
    def _labels_exist(cls, labels: dict[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
        for category, names in labels.items():
            unknown = sorted(set(names) - set(KNOWN) | set(names) & {PERSON})
            if unknown or not names:
                known = ", ".join(label for label in KNOWN if label != PERSON)
                raise ValueError(f"{category}: {unknown or 'no label'}; detectors know {known}")
        return labels

    def for_category(self, category: str) -> DetectConfig:
        """The settings for one object: nobody having named it asks for a surer box."""
        if category not in ANY_CATEGORY:
            return self
        return self.model_copy(update={"object_threshold": self.unnamed_threshold})

    @property
    def needed_models(self) -> Literal["none", "pose", "all"]:
        """Which model files this needs, see :func:`hoi.detect.models.fetch_models`."""
        if self.masks != "given":
            # a stronger model brings its own boxes; ``auto`` may still turn out to be none
            return "all" if self.strong.instances in ("none", "auto") else "pose"
        if self.keypoints == "registry" or self.landmarks == "registry":
            return "pose"
        return "none"
