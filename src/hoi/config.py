"""The configuration of a run: one model that rejects unknown keys and bad values by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, cast

import yaml
from pydantic import Field, PositiveInt, ValidationError, model_validator

from hoi.actions.config import ActionsConfig
from hoi.datasets.behave_config import BehaveConfig
from hoi.datasets.behave_mini.config import BehaveMiniConfig
from hoi.datasets.photos_config import PhotosConfig
from hoi.detect.config import DetectConfig
from hoi.errors import ConfigError
from hoi.evaluate.config import EvaluateConfig
from hoi.exemplars.config import ExemplarsConfig
from hoi.interactions.config import InteractionsConfig
from hoi.joint.config import JointConfig
from hoi.objectfit.config import ObjectFitConfig
from hoi.priors.config import LookupConfig, PriorsConfig, StudyConfig
from hoi.readers.config import DataSet, OtherSystems
from hoi.report.config import ReportConfig
from hoi.segmenter.config import SegmenterRecipe
from hoi.settings import Settings
from hoi.smplify.config import SmplifyConfig

DEFAULT_BODY_MODEL = "src/hoi/data/body/neutral.npz"
ALL_MINI_FRAMES = 12  # per action: what `frames: all` means for a set that has no end
POSE_DATABASE = "src/hoi/data/poses/database.npz"
ACTION_SPACE = "src/hoi/data/conceptnet/actions.tsv"


class AssetsConfig(Settings):
    """Licensed or own files that replace the embedded ones."""

    body_model: str = Field(
        default=DEFAULT_BODY_MODEL, description="SMPL .pkl or .npz, or the embedded CC0 body"
    )
    pose_database: str = Field(default=POSE_DATABASE, description="labelled poses (npz)")
    action_space: str = Field(
        default=ACTION_SPACE,
        description="what objects are used for (tsv); `hoi conceptnet` makes one from the dump",
    )
    own_objects: str = Field(
        default="my_objects", description="folder that `hoi add-object` fills; need not exist"
    )


class MethodConfig(Settings):
    """One method of the tables: an object search and a joint optimisation."""

    search: str = Field(default="upright", description="a key of objectfit")
    priors: str = Field(default="", description="a key of prior_variants; empty: the run's priors")
    joint: dict[str, Any] = Field(
        default={}, description="settings of the joint stage, see JointConfig"
    )


class TablesConfig(Settings):
    """Which methods each table compares."""

    methods: tuple[str, ...] = ("phosa", "ours")
    accuracy: tuple[str, ...] = Field(
        default=("ours", "phosa"),
        description="methods of results/accuracy.csv; the others are compared with the first",
    )
    ablation: tuple[str, ...] = ("no_action", "no_contact", "no_normal", "ours")
    prior_noise: tuple[str, ...] = Field(
        default=(), description="results/prior_noise.csv: methods with wrong answers, and without"
    )
    ablation_group: Literal["chair", "table", "keyboard", "backpack"] = "chair"


class RunConfig(Settings):
    """Everything in ``config/config.yaml``."""

    dataset: Literal["auto", "behave", "behave_mini"] = "auto"
    split: Literal["test", "tune", "train"] = "test"
    frames: PositiveInt | Literal["default", "all"] = Field(
        default="default", description="frames per action"
    )
    seed: int = Field(default=0, ge=0)
    chunk_size: PositiveInt = Field(default=8, description="frames a job works through")
    memo: str = Field(default=".cache/hoi", description="folder that remembers what was computed")
    behave: BehaveConfig = BehaveConfig()
    behave_mini: BehaveMiniConfig = BehaveMiniConfig()
    photos: PhotosConfig = PhotosConfig()
    interactions: InteractionsConfig = InteractionsConfig()
    assets: AssetsConfig = AssetsConfig()
    exemplars: ExemplarsConfig = ExemplarsConfig()
    other_systems: dict[DataSet, OtherSystems] = Field(
        default={}, description="files of other systems, by data set: docs/other_systems.md"
    )
    detect: DetectConfig = DetectConfig()
    detect_photos: DetectConfig = DetectConfig(masks="prefer_given", keypoints="registry")
    segmenter: SegmenterRecipe = Field(
        default=SegmenterRecipe(), description="how the weights of the mask network are made"
    )
    smplify: SmplifyConfig = SmplifyConfig()
    objectfit: dict[str, ObjectFitConfig] = Field(default={}, description="named searches")
    actions: ActionsConfig = ActionsConfig()
    priors: PriorsConfig = PriorsConfig()
    prior_variants: dict[str, LookupConfig] = Field(
        default={}, description="named other ways to look priors up, for methods and studies"
    )
    prior_study: StudyConfig = Field(default=StudyConfig(), description="results/priors.csv")
    methods: dict[str, MethodConfig] = Field(default={}, description="named methods")
    tables: TablesConfig = TablesConfig()
    evaluate: EvaluateConfig = EvaluateConfig()
    report: ReportConfig = ReportConfig()

    @model_validator(mode="after")
    def _references(self) -> RunConfig:
        for table, methods in (
            ("tables.methods", self.tables.methods),
            ("tables.ablation", self.tables.ablation),
            ("tables.prior_noise", self.tables.prior_noise),
            ("tables.accuracy", self.tables.accuracy),
        ):
            for method in methods:
                if method not in self.methods:
                    raise ValueError(f"{table}: no method {method!r} under `methods`")
        for name, method in self.methods.items():
            if method.search not in self.objectfit:
                raise ValueError(
                    f"methods.{name}.search: no search {method.search!r} under `objectfit`"
                )
            if method.priors and method.priors not in self.prior_variants:
                raise ValueError(
                    f"methods.{name}.priors: no variant {method.priors!r} under `prior_variants`"
                )
            searched, joint = self.objectfit[method.search].camera, self.joint_settings(name).camera
            if searched != joint:
                raise ValueError(
                    f"methods.{name}.joint.camera: {joint}, but its search {method.search!r} "
                    f"believes in {searched}"
                )
        self._contacts_are_used()
        if self.dataset == "behave" and not self.behave.root:
            raise ValueError("behave.root: dataset is behave, so the folder must be named")
        return self

    def _contacts_are_used(self) -> None:
        """Files of contacts per vertex need a method that takes them, and the other way round."""
        named = [d for d, systems in self.other_systems.items() if systems.contacts is not None]
        takers = [m for m in self.methods if self.joint_settings(m).contact == "vertices"]
        if named and not takers:
            raise ValueError(
                f"other_systems.{named[0]}.contacts: no method takes them; "
                "set methods.<name>.joint.contact: vertices"
            )
        if takers and not named:
            raise ValueError(
                f"methods.{takers[0]}.joint.contact: vertices needs their files, "
                "other_systems.<data set>.contacts"
            )

    @property
    def dataset_name(self) -> str:
        """The data set of the tables: BEHAVE when the user has it, else the embedded one."""
        if self.dataset == "auto":
            return "behave" if self.behave.root else "behave_mini"
        return self.dataset

    @property
    def behave_root(self) -> Path:
        if not self.behave.root:
            raise ConfigError("behave.root is not set")
        return Path(self.behave.root).expanduser()

    @property
    def behave_mini_settings(self) -> BehaveMiniConfig:
        """The generator's settings with the run's number of frames."""
        if self.frames == "default":
            return self.behave_mini
        count = ALL_MINI_FRAMES if self.frames == "all" else self.frames
        return self.behave_mini.model_copy(update={"frames_per_action": count})

    def joint_settings(self, method: str) -> JointConfig:
        """The joint stage's settings of one method; its name is filled in."""
        return JointConfig(**{"method": method, **self.methods[method].joint})

    def detect_settings(self, dataset: str) -> DetectConfig:
        """How people and objects are found: photos bring no masks, data sets do."""
        from hoi.detect.strong.selection import resolved

        settings = self.detect_photos if dataset in ("photos", "interactions") else self.detect
        others = self.systems_for(dataset)
        given: dict[str, Any] = {}
        if others.masks is not None:
            given["masks"] = "given"
        if others.keypoints is not None:
            given["keypoints"] = "given"
        settings = settings.model_copy(update=given)
        return settings if settings.masks == "given" else resolved(settings)

    def systems_for(self, dataset: str) -> OtherSystems:
        """The files of other systems that one data set's frames take."""
        return self.other_systems.get(cast(DataSet, dataset), OtherSystems())


def load_config(path: Path | str) -> RunConfig:
    """Read a configuration file; raises ConfigError when it is not there or not usable."""
    return load_configs([path])


def load_configs(
    paths: Sequence[Path | str], overrides: Mapping[str, Any] | None = None
) -> RunConfig:
    """Read several files as Snakemake does: settings of later ones go before earlier ones.

    Args:
        paths: at least one file.
        overrides: settings that go before all files.

    Raises ConfigError when a file is not there or the whole is not usable.
    """
    values: dict[str, Any] = {}
    for path in paths:
        _update(values, _settings_in(path))
    _update(values, overrides or {})
    return read_config(values, ", ".join(map(str, paths)))


def _update(values: dict[str, Any], changes: Mapping[str, Any]) -> None:
    for key, value in changes.items():
        if isinstance(value, Mapping) and isinstance(values.get(key), dict):
            _update(values[key], value)
        else:
            values[key] = value


def _settings_in(path: Path | str) -> dict[str, Any]:
    try:
        values = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: there is no such file") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not readable as YAML: {error}") from error
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: expected settings by name, found {type(values).__name__}")
    return values


def read_config(values: Mapping[str, Any], origin: str = "config/config.yaml") -> RunConfig:
    """Validate a configuration; raises ConfigError with one line per wrong key."""
    try:
        return RunConfig(**values)
    except ValidationError as error:
        lines = []
        for problem in error.errors():
            key = ".".join(str(part) for part in problem["loc"])
            message = problem["msg"].removeprefix("Value error, ")
            if problem["type"] == "extra_forbidden":
                message = "unknown key"
            given = problem.get("input")
            shown = f" (given: {given!r})" if isinstance(given, str | int | float) else ""
            lines.append(f"  {key}: {message}{shown}" if key else f"  {message}")
        raise ConfigError(f"{origin}:\n" + "\n".join(lines)) from None
