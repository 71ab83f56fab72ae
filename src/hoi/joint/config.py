"""Every number of the joint stage. A method is a list of loss terms and how they are minimised."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, PositiveFloat, PositiveInt, field_validator, model_validator

from hoi.settings import CameraModel, Settings

#: The loss terms a method may list: `hoi.joint.terms` holds one function for each.
TermName = Literal[
    "contact",
    "normal",
    "penetration",
    "object_scale",
    "human_scale",
    "reprojection",
    "ground",
    "phosa_silhouette",
    "phosa_coarse",
    "phosa_parts",
    "phosa_object_scale",
    "phosa_human_scale",
    "phosa_ordinal_depth",
]


class Schedule(Settings):
    """How the loss is minimised. Parameters: rotation (6D), translation, log scales."""

    optimiser: Literal["adam", "lbfgs"] = "adam"
    iterations: PositiveInt = Field(default=500, description="[3.4] 500")
    learning_rate: PositiveFloat = Field(
        default=2e-3, description="[3.4] Adam 2e-3; lbfgs ignores it"
    )
    decay: bool = Field(
        default=False, description="lower the learning rate linearly to a twentieth"
    )
    depth_grid: int = Field(
        default=0,
        ge=0,
        description="scales tried before the first step; 0: start at the size prior",
    )
    depth_grid_range: PositiveFloat = Field(
        default=0.7,
        description="the grid spans exp(-r)..exp(r): sizes of one category differ by twice",
    )


class ContactRule(Settings):
    """How the interaction map becomes pairs of point sets. Not given by the paper's text."""

    two_hands_from: PositiveFloat = Field(
        default=1.6,
        description="both of a pair (hands, feet) must touch when the expected number of touching "
        "ones, sum over object parts of probability x (1 either, 1.5 unsaid, 2 both), reaches this",
    )
    likely_part: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="a hand may touch the object parts with at least this share of the most "
        "probable part's probability",
    )
    support_parts: tuple[str, ...] = Field(
        default=("butt", "left_thigh", "right_thigh", "lap"),
        description="regions that rest their weight on the object: pulled both ways",
    )
    support_weight: float = 1.0
    support_reverse_weight: float = 0.25
    support_reverse_parts: tuple[str, ...] = Field(
        default=("chair_seat",),
        description="object parts that the sitter covers. A larger part, a tabletop, is not pulled "
        "to the body, or its middle would come to lie under a person who sits on its edge",
    )
    leaning_weight: float = Field(default=0.5, description="weight of every other large region")


class Phosa(Settings):
    """Numbers of the PHOSA baseline (Zhang et al., ECCV 2020), besides its term weights."""

    box_expansion: float = Field(
        default=0.3, ge=0, description="boxes grow by this share before overlap"
    )
    depth_gap: PositiveFloat = Field(
        default=2.0,
        description="parts interact when their depth ranges are nearer than this, metres",
    )
    depth_clamp: PositiveFloat = Field(
        default=2.0, description="ordinal depth: violations count to here"
    )
    depth_resolution: PositiveInt = Field(
        default=96, description="ordinal depth: pixels of the ROI's side"
    )
    image_size: PositiveInt = Field(
        default=640, description="longest image side at which PHOSA counts ordinal-depth pixels"
    )


class LimbSettings(Settings):
    """How far the touching limbs may follow the object, as standard deviations."""

    reach: PositiveFloat = Field(
        default=0.3, description="metres; a limb farther from the object than this is left alone"
    )
    done: float = Field(default=0.01, ge=0, description="metres; a nearer limb touches already")
    touching_share: float = Field(
        default=0.2, gt=0, le=1, description="share of a hand's or foot's vertices that touch"
    )
    contact_m: PositiveFloat = Field(default=0.03, description="of the touching vertices, metres")
    keypoint_share: PositiveFloat = Field(
        default=0.012, description="of a keypoint, as a share of the body's height in the picture"
    )
    pose_deg: PositiveFloat = Field(default=6.0, description="of a joint's rotation vector")
    iterations: PositiveInt = Field(default=25, description="L-BFGS")


class JointConfig(Settings):
    """Configuration of the joint stage; `config/config.yaml` has one set per method."""

    method: str = Field(default="ours", description="name of the method in the tables")
    camera: CameraModel = Field(
        default="photo",
        description="longest_side: PHOSA's guess; the method's search must share it",
    )
    action: Literal["retrieved", "default", "hypotheses", "true"] = Field(
        default="retrieved",
        description="retrieved: of the nearest pose [3.2]; default: ConceptNet's heaviest action, "
        "the 'No action' ablation; hypotheses: every likely action is tried, selection decides; "
        "true: an oracle, what the data set says (where it says nothing, the retrieved one)",
    )

    @field_validator("action", mode="before")
    @classmethod
    def _yaml_true(cls, value: object) -> object:
        return "true" if value is True else value  # YAML reads the word as a truth value

    oracle: Literal["none", "body", "choice"] = Field(
        default="none",
        description="what the method is told of the truth, to see where its error comes from. "
        "body: the true body; choice: which hypothesis is nearest to the true object. Never a "
        "result",
    )
    action_weight: float = Field(
        default=0.02,
        ge=0,
        description="selection among action hypotheses: weight of -log p(action | pose). On the "
        "tuning split 0 to 0.03 gave 11.7 to 11.9 cm, 0.05 and more 13.4, one action 13.7",
    )
    terms: dict[TermName, float] = Field(
        default={
            "contact": 1.0,
            "normal": 0.01,
            "penetration": 0.01,
            "object_scale": 0.1,
            "reprojection": 0.0005,
            "ground": 1.0,
        },
        description="the method: loss terms and weights. [3.4] contact 1, normal .01, "
        "penetration .01, object_scale and human_scale .01, reprojection .0005",
    )
    contact: Literal["paper", "recipe", "vertices"] = Field(
        default="recipe",
        description="paper: every listed pair, object part to body part [3.4]; recipe: body part "
        "to the nearest of the parts it may touch; vertices: contact probability per body vertex "
        "from files, see other_systems",
    )
    contact_threshold: float = Field(
        default=0.5, gt=0, le=1, description="vertices: probability from which a vertex touches"
    )
    contact_patches: PositiveInt = Field(
        default=8, description="vertices: at most so many patches of skin, the largest"
    )
    contact_sets: Literal["one", "alternatives"] = Field(
        default="one",
        description="one: the listed contacts of an action, as in the paper; alternatives: also "
        "each other set that the prior holds, and selection decides",
    )
    no_contact: Literal["ignore", "weigh"] = Field(
        default="ignore",
        description="the prior's probability that nothing touches. weigh: contacts count by the "
        "probability that something does",
    )
    size: Literal["single", "range"] = Field(
        default="single",
        description="single: the prior's one size [3.4]; range: its height, width and depth may be "
        "anything within the prior's ranges, where it has them",
    )
    opposing_normals: bool = Field(default=True, description="[3.4] only opposing surfaces touch")
    human_scale: Literal["fixed", "free"] = Field(default="fixed", description="[3.4] free")
    schedule: Literal["fast", "paper"] = "fast"
    fast: Schedule = Schedule(
        optimiser="lbfgs", iterations=40, learning_rate=1e-2, decay=True, depth_grid=57
    )
    paper: Schedule = Schedule()
    limbs: Literal["fixed", "refined"] = Field(
        default="fixed",
        description="refined: at the end the touching arms and legs follow the object. On the "
        "tuning split: body 5.52 -> 5.44 cm, object 10.8 -> 10.9, contacts recalled at 5 cm "
        ".44 -> .52",
    )
    limb_settings: LimbSettings = LimbSettings()
    contact_rule: ContactRule = ContactRule()
    phosa: Phosa = Phosa()
    max_hypotheses: PositiveInt = Field(
        default=10, description="object poses taken from the object fit"
    )
    poses_per_exemplar: PositiveInt = Field(
        default=2, description="... and at most so many per exemplar"
    )
    part_points: PositiveInt = Field(
        default=96, description="points sampled on an object or body part"
    )
    surface_points: PositiveInt = Field(default=400, description="points that penetration looks at")
    paper_points: PositiveInt = Field(
        default=1000, description="[3.5] vertices per object: penetration sums over so many"
    )
    sdf_grid: int = Field(default=32, ge=2, description="[3.4] 8 cells a side; 32 costs 0.2 s")
    sdf_margin: float = Field(
        default=0.08, ge=0, description="metres around the body covered by the grid"
    )
    silhouette_resolution: PositiveInt = Field(default=128, description="pixels of the ROI's side")
    keep_threshold: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="cells covered by the person more than this are ignored",
    )
    weights_resolution: PositiveInt = Field(
        default=256, description="resolution for which the reprojection weight is meant"
    )
    edge_weight: float = Field(default=0.2, ge=0, description="boundary term inside reprojection")
    roi_margin: float = Field(
        default=0.3,
        ge=0,
        description="share around the mask, used when the object fit names no region",
    )
    order_weight: float = Field(
        default=3.0,
        ge=0,
        description="selection: weight of the occlusion-order violation; 0: loss alone. On the "
        "tuning split of behave_mini 1, 3 and 10 gave 15.5, 12.5 and 12.3 cm",
    )
    consensus: float = Field(
        default=0.1,
        ge=0,
        description="selection: how much the score of hypotheses may differ that are about as "
        "likely; of these the one in the middle is kept. 0: the lowest score. On the tuning split "
        "0 gave 11.7 cm, 0.05 to 0.2 10.8 to 11.4, 0.3 and more 11.7 and worse",
    )
    untouched_cost: float = Field(
        default=0.1,
        ge=0,
        description="selection: what a hypothesis pays under whose action nothing touches, as a "
        "contact missed by 0.3 m would; for free it beats all others, wherever the object drifts. "
        "On the tuning split with a language model's answers 0 gave 33.7 cm, 0.03 21.5, 0.1 14.1, "
        "0.3 14.0; the recorded answers have no such action of chairs",
    )
    arrangement_weight: float = Field(
        default=0.0,
        ge=0,
        description="selection: weight of how much a hypothesis contradicts what the prior says of "
        "where the object is and which way it faces, 0..1",
    )
    depth_order_weight: float = Field(
        default=0.3,
        ge=0,
        description="weight of that violation where the depth grid is searched. On the tuning "
        "split 0.3 was better than 0 in 11 frames and worse in 5 of 69, by more than 1 cm",
    )
    order_resolution: PositiveInt = Field(default=64, description="z-buffer pixels for both")
    order_tolerance: float = Field(
        default=0.02, ge=0, description="metres by which an order must be wrong"
    )
    touch_distance: PositiveFloat = Field(
        default=0.05, description="report: contact fades from 1 at 0 to 0 at this distance, metres"
    )

    @model_validator(mode="after")
    def _has_terms(self):
        if not self.terms:
            raise ValueError("terms: a method needs at least one loss term")
        if self.limbs == "refined" and self.human_scale == "free":
            raise ValueError("limbs: refined needs human_scale fixed")
        if self.limbs == "refined" and self.oracle == "body":
            raise ValueError("limbs: the true body is not refined")
        return self

    @property
    def chosen_schedule(self) -> Schedule:
        return self.fast if self.schedule == "fast" else self.paper
