# What people look at: a page a frame, a gallery, scenes and overlays, the table of photos


from hoi.digest import files_digest, json_digest
from hoi.report import asset_files


def drawing_identity(script, settings=None):
    """One digest of what a drawing depends on: settings, code, templates, shared scripts.

    Short, because Snakemake's report prints the parameters of every result. The settings
    themselves are those of `report`, which the scripts read from the configuration.
    """
    shared = Path(workflow.basedir) / "workflow" / "scripts" / "frame_artifacts.py"
    return json_digest(
        [
            identity(script, CONFIG.report if settings is None else settings),
            files_digest(asset_files()),
            code_digest(str(shared)),
        ]
    )[:16]


SETTINGS_FILE = "results/{dataset}/settings/{group}.json"


def methods_of(dataset, group):
    """What pages and galleries compare: the tables' methods, for their group the ablation, too."""
    if dataset == PHOTOS:
        return ("ours",)
    more = CONFIG.tables.ablation if group == CONFIG.tables.ablation_group else ()
    return tuple(dict.fromkeys((*CONFIG.tables.methods, *(more if CONFIG.report.ablation else ()))))


def frame_chunk(dataset, frame):
    """The chunk that holds a frame. Groups are planned in turn, so only what is asked is read."""
    for group in [PHOTOS] if dataset == PHOTOS else groups_here():
        for chunk in chunks_of(group):
            if frame in chunk.frame_ids:
                return chunk
    raise WorkflowError(f"There is no frame {frame} in the configured data.")


def page_chunk(wildcards):
    return frame_chunk(wildcards.dataset, wildcards.frame)


def page_inputs(wildcards):
    chunk = page_chunk(wildcards)
    return artifact_indexes(wildcards.dataset, chunk) | {
        "seconds": stage_seconds(wildcards.dataset, chunk),
        "pose_database": pose_database_of(chunk),
    }


def page_labels(wildcards):
    """How the report lists a page: by action and frame, in one label.

    One, because Snakemake 9.27's report makes a switch of any further label that has two equally
    frequent values, and then fails where a frame exists for one of them only.
    """
    frames = page_chunk(wildcards).frames
    action = next(frame.action for frame in frames if frame.frame_id == wildcards.frame)
    return {"frame": f"{action} · {wildcards.frame}" if action else wildcards.frame}


def artifact_indexes(dataset, chunk, methods=None):
    """Indexes of every stage for one chunk, by name; of all methods that are compared, or some."""
    base, name = f"results/{dataset}", f"{chunk.name}.json"
    named = {
        "frames": f"{base}/frames/{name}",
        "detections": f"{base}/detect/{name}",
        "bodies": f"{base}/smplify/{name}",
        "actions": f"{base}/actions/{name}",
        "priors": f"{base}/priors/{name}",
        "body_model": CONFIG.assets.body_model,
        "exemplars": exemplars_of(chunk),
        "settings": SETTINGS_FILE.format(dataset=dataset, group=chunk.group),
    }
    for method in methods or methods_of(dataset, chunk.group):
        named[f"{method}_objects"] = f"{base}/objectfit/{CONFIG.methods[method].search}/{name}"
        named[f"{method}_joints"] = f"{base}/joint/{method}/{name}"
        if dataset != PHOTOS:
            named[f"{method}_evaluations"] = f"{base}/evaluate/{method}/{name}"
    if dataset != PHOTOS:
        named["truth"] = f"{base}/truth/{name}"
    return named


def stage_seconds(dataset, chunk):
    """Time sheets of every stage for one chunk, by the stage's folder."""
    stages = [stage for method in methods_of(dataset, chunk.group) for stage in stages_of(method)]
    return [f"results/{dataset}/{s}/{chunk.name}.seconds.json" for s in dict.fromkeys(stages)]


def shown_settings(dataset, group):
    """The configuration behind a page, stage by stage."""
    methods = methods_of(dataset, group)
    searches = dict.fromkeys(CONFIG.methods[method].search for method in methods)
    found = {
        "seed": CONFIG.seed,
        "assets": CONFIG.assets,
        "exemplars": CONFIG.exemplars,
        "detect": CONFIG.detect_settings(dataset),
        "smplify": CONFIG.smplify,
        "objectfit": {name: CONFIG.objectfit[name] for name in searches},
        "actions": CONFIG.actions,
        "priors": CONFIG.priors,
        "joint": {name: CONFIG.joint_settings(name) for name in methods},
    }

    def plain(value):
        if isinstance(value, dict):
            return {key: plain(entry) for key, entry in value.items()}
        return value if isinstance(value, int) else value.model_dump(mode="json")

    return plain(found)


rule shown_settings:
    # what a page says of its configuration, in a file: parameters stay short
    output:
        SETTINGS_FILE,
    params:
        settings=lambda wildcards: shown_settings(wildcards.dataset, wildcards.group),
        frames=lambda wildcards: frame_labels(chunks_of(wildcards.group)),
    message:
        "Noting the settings and frames of {wildcards.group}"
    log:
        "logs/{dataset}/settings/{group}.log",
    script:
        "../scripts/shown_settings.py"


rule page:
    input:
        unpack(page_inputs),
    output:
        report(
            "results/{dataset}/pages/{frame}.html",
            caption="../report/frame.rst",
            category=FRAMES,
            subcategory=lambda wildcards: page_chunk(wildcards).group,
            labels=page_labels,
        ),
    params:
        methods=lambda wildcards: list(methods_of(wildcards.dataset, page_chunk(wildcards).group)),
        index=lambda wildcards: f"../gallery/{page_chunk(wildcards).group}.html",
        identity=drawing_identity("page"),
    message:
        "Drawing the page of {wildcards.frame}"
    log:
        "logs/{dataset}/pages/{frame}.log",
    script:
        "../scripts/page.py"


def shown_frames(group):
    """The frames that get a page of their own, evenly over actions."""
    from hoi.report.gallery import pick_frames

    frames = [frame for chunk in chunks_of(group) for frame in chunk.frames]
    return pick_frames([(f.frame_id, f.action) for f in frames], CONFIG.report.max_frames)


def gallery_of(group):
    return f"results/{dataset_of(group)}/gallery/{group}.html"


def gallery_inputs(dataset, groups):
    """Everything of some groups, and the pages of their frames."""
    named = {"pages": []}
    for group in groups:
        named["pages"] += [f"results/{dataset}/pages/{f}.html" for f in shown_frames(group)]
        for chunk in chunks_of(group):
            for name, paths in artifact_indexes(dataset, chunk).items():
                paths = [paths] if isinstance(paths, str) else paths
                known = named.setdefault(name, [])
                known += [path for path in paths if path not in known]
    return named


rule gallery:
    input:
        unpack(lambda wildcards: gallery_inputs(wildcards.dataset, [wildcards.group])),
    output:
        report(
            "results/{dataset}/gallery/{group}.html",
            caption="../report/gallery.rst",
            category=GALLERY,
            labels={"group": "{group}"},
        ),
    params:
        methods=lambda wildcards: list(methods_of(wildcards.dataset, wildcards.group)),
        heading="{dataset}: {group}",
        identity=drawing_identity("gallery"),
    message:
        "Drawing the gallery of {wildcards.group}"
    log:
        "logs/{dataset}/gallery/{group}.log",
    script:
        "../scripts/gallery.py"


def index_groups():
    return CONFIG.report.groups


def index_tables(_):
    named = {f"table_{group}": f"results/behave_{group}.csv" for group in index_groups()}
    if CONFIG.tables.ablation_group in index_groups() and CONFIG.report.ablation:
        named["table_ablation"] = "results/ablation.csv"
    return named


rule index:
    # the report to open first: tables whose numbers lead to their frames, causes, all frames
    input:
        unpack(lambda _: gallery_inputs(DATASET, index_groups())),
        unpack(index_tables),
        others=["results/actions.html"],
    output:
        report(
            "results/index.html",
            caption="../report/index.rst",
            category=GALLERY,
            labels={"group": "all"},
        ),
    params:
        methods=list(dict.fromkeys(m for g in index_groups() for m in methods_of(DATASET, g))),
        heading="People and the objects they use",
        identity=drawing_identity("gallery"),
    message:
        "Drawing results/index.html"
    log:
        "logs/index.log",
    script:
        "../scripts/gallery.py"


rule scenes:
    # for every frame an overlay picture; scene, parameters and turntable where there is a result
    input:
        unpack(
            lambda wildcards: artifact_indexes(
                wildcards.dataset, chunk_named(wildcards.chunk), ["ours"]
            )
        ),
    output:
        "results/{dataset}/scenes/{chunk}.json",
    params:
        method="ours",
        identity=drawing_identity("scenes"),
    message:
        "Writing the scenes of {wildcards.chunk}"
    log:
        "logs/{dataset}/scenes/{chunk}.log",
    script:
        "../scripts/scenes.py"


# the frame of the README's picture, and its sharpness
OVERVIEW_FRAME = "Date03_Sub04_chairblack_sit-t0003.000"
OVERVIEW_SHARP = {"image_width": 800, "tile_width": 400, "supersampling": 3}


rule overview:
    # the picture of the README; no part of `all`: snakemake -j2 docs/overview.jpg
    input:
        unpack(
            lambda wildcards: artifact_indexes(
                "behave_mini", frame_chunk("behave_mini", OVERVIEW_FRAME), ["ours"]
            )
        ),
    output:
        "docs/overview.jpg",
    params:
        frame=OVERVIEW_FRAME,
        method="ours",
        sharp=OVERVIEW_SHARP,
        identity=drawing_identity("overview"),
    message:
        "Drawing the README's picture"
    log:
        "logs/overview.log",
    script:
        "../scripts/overview.py"


rule table_photos:
    # your own photos: one row each, with the reason where there is no result
    input:
        joints=lambda wildcards: indexes(PHOTOS, "joint/ours"),
        detections=lambda wildcards: indexes(PHOTOS, "detect"),
        bodies=lambda wildcards: indexes(PHOTOS, "smplify"),
        objects=lambda wildcards: indexes(PHOTOS, f"objectfit/{CONFIG.methods['ours'].search}"),
        scenes=lambda wildcards: indexes(PHOTOS, "scenes"),
        frames=lambda wildcards: indexes(PHOTOS, "frames"),
        gallery=lambda wildcards: gallery_of(PHOTOS),
        seconds=lambda wildcards: seconds(PHOTOS, stages_of("ours")),
    output:
        report(
            "results/photos.csv",
            caption="../report/photos.rst",
            category=TABLES,
            labels={"table": "photos", "form": "csv"},
        ),
    params:
        identity=identity("table_photos", {}),
    message:
        "Collecting results/photos.csv"
    log:
        "logs/photos/table.log",
    script:
        "../scripts/table_photos.py"
