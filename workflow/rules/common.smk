# What every rule shares: the validated configuration, the plan of frames, and the parameters
# that make a rerun follow content.

import os
from pathlib import Path

from snakemake.exceptions import WorkflowError

# one thread a job; -j gives the parallelism. Set before any library starts its own pool.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

from hoi.config import POSE_DATABASE, read_config
from hoi.datasets.photos_config import AUTO
from hoi.digest import code_digest, environment_digest
from hoi.errors import HoiError, NoFramesError
from hoi.exemplars.categories import doubtful_categories, known_categories
from hoi.exemplars.shape_index import folder_state
from hoi.manifest import INTERACTIONS, PHOTOS, chunk_settings, frame_labels, plan
from hoi.own_objects.description import (
    description_path, detector_labels, mesh_paths, own_objects, with_own_categories,
)
from hoi.priors.tables import NEEDED_TABLES, RICHER_TABLES

try:
    CONFIG = read_config(config)
    known_categories(CONFIG.exemplars)  # its folders are there
    OWN_OBJECTS = own_objects(CONFIG.assets.own_objects)
except HoiError as error:
    raise WorkflowError(f"The configuration is not usable.\n{error}")

# where results are remembered is no part of any result, so scripts read it past the parameters
config["memo"] = CONFIG.memo
config["prior_study"] = CONFIG.prior_study.model_dump(mode="json")
config["language_model"] = CONFIG.priors.llm.model_dump(mode="json")

GROUPS = ("chair", "table", "keyboard", "backpack")
DATASET = CONFIG.dataset_name
if DATASET == "behave" and not CONFIG.behave_root.is_dir():
    raise WorkflowError(f"behave.root: there is no folder {CONFIG.behave_root}")

# The report lists its categories by name, so the names bring the order of reading.
TABLES, GALLERY, FRAMES = "1 Tables", "2 Gallery", "3 Frames"
_PLANS = {}


def chunks_of(group):
    """The chunks of a table group, planned once."""
    if group not in _PLANS:
        try:
            _PLANS[group] = plan(CONFIG, group)
        except HoiError as error:
            raise WorkflowError(f"The frames of {group} cannot be listed.\n{error}") from error
    return _PLANS[group]


def groups_here():
    """The groups that the data set has frames of, planned in turn; an error where it has none."""
    nothing_yet = True
    for group in GROUPS:
        try:
            chunks_of(group)
        except WorkflowError as error:
            last = nothing_yet and group == GROUPS[-1]
            if last or not isinstance(error.__cause__, NoFramesError):
                raise
        else:
            nothing_yet = False
            yield group


def chunk_named(name):
    group = name.rpartition("-")[0]
    return next(chunk for chunk in chunks_of(group) if chunk.name == name)


def dataset_of(group):
    return group if group in (PHOTOS, INTERACTIONS) else DATASET


def indexes(group, stage):
    """The indexes of one stage for all chunks of a group."""
    dataset = dataset_of(group)
    return [f"results/{dataset}/{stage}/{chunk.name}.json" for chunk in chunks_of(group)]


def seconds(group, stages):
    """The time sheets of some stages for all chunks of a group."""
    dataset = dataset_of(group)
    return [
        f"results/{dataset}/{stage}/{chunk.name}.seconds.json"
        for stage in stages
        for chunk in chunks_of(group)
    ]


def priors_of(method):
    """Where a method's priors are: those of the run, or of a variant."""
    variant = CONFIG.methods[method].priors
    return f"priors/{variant}" if variant else "priors"


def stages_of(method):
    """The stages whose time one method's result takes, in order."""
    search = CONFIG.methods[method].search
    return (
        "frames", "detect", "smplify", f"objectfit/{search}", "actions", priors_of(method),
        f"joint/{method}",
    )


ACTION_SPACE = CONFIG.assets.action_space
BEHAVE_MINI_ASSETS = [
    "src/hoi/data/body/neutral.npz",
    *(f"src/hoi/data/furniture/{name}.npz" for name in ("chair", "stool", "table", "backpack", "suitcase", "keyboard")),
]
PRIOR_TABLE_NAMES = (*NEEDED_TABLES, *RICHER_TABLES)
RECORDED_PRIORS = [f"src/hoi/data/priors/{name}.csv" for name in PRIOR_TABLE_NAMES]
ASKED_PRIORS = [f"resources/priors/{name}.csv" for name in PRIOR_TABLE_NAMES]
PRIOR_TABLES = ASKED_PRIORS if CONFIG.priors.source == "llm" else RECORDED_PRIORS
# the same with the user's own objects, see rule own_knowledge
OWN_POSES = "resources/own/poses.npz"
OWN_ACTION_SPACE = "resources/own/actions.tsv"
OWN_PRIOR_TABLES = [f"resources/own/priors/{Path(table).name}" for table in PRIOR_TABLES]


KNOWN_CATEGORIES = with_own_categories(known_categories(CONFIG.exemplars), OWN_OBJECTS)


def own_categories(chunk):
    """The user's own objects that a chunk may show."""
    if AUTO in chunk.categories:
        return list(OWN_OBJECTS)
    return [name for name in chunk.categories if name in OWN_OBJECTS]


def shows_own(wildcards):
    return bool(own_categories(chunk_named(wildcards.chunk)))


def pose_database_of(chunk):
    """The poses among which those of the chunk's people are looked up."""
    return OWN_POSES if own_categories(chunk) else CONFIG.assets.pose_database


def exemplars_of(chunk):
    """Library files of the chunk's categories; a category that nobody can build has none."""
    known = KNOWN_CATEGORIES
    # nobody knows yet what an unnamed photo shows
    wanted = chunk.categories
    if AUTO in chunk.categories:
        doubtful = doubtful_categories(CONFIG.exemplars)
        wanted = [name for name in known if name not in doubtful]
    return [f"resources/exemplars/{name}.npz" for name in wanted if name in known]


def with_labels(settings, categories):
    """Settings of the detector that know which of its classes stand for own objects."""
    labels = detector_labels(OWN_OBJECTS, categories)
    return settings.model_copy(update={"labels": labels | settings.labels}) if labels else settings


def detect_settings(wildcards):
    settings = CONFIG.detect_settings(wildcards.dataset)
    return with_labels(settings, own_categories(chunk_named(wildcards.chunk)))


def exemplar_files(wildcards):
    return exemplars_of(chunk_named(wildcards.chunk))


def identity(script, settings):
    """What a result depends on besides its input files: settings, code, library versions.

    One dict, because Snakemake compares the *set* of parameter values: two values that swap
    places would go unnoticed. Digests, because Snakemake does not look into imported modules.
    """
    scripts = Path(workflow.basedir) / "workflow" / "scripts"
    return {
        "settings": settings if isinstance(settings, dict) else settings.model_dump(mode="json"),
        "code": code_digest(str(scripts / f"{script}.py"), str(scripts / "chunk_job.py")),
        "environment": environment_digest(),
    }


def stage_identity(stage, settings):
    """The same for a stage that works through frames: the run's seed counts, too."""
    return identity(stage, settings) | {"seed": CONFIG.seed}


wildcard_constraints:
    dataset="behave|behave_mini|photos|interactions",
    chunk=r"[a-z]+-\d\d\d+",
    group=r"[a-z]+",
    category=r"[a-z_ ]+",
    search=r"\w+",
    method=r"\w+",
    variant=r"\w+",
    frame=r"[\w.\-]+",
