# What people look at: a page a frame, a gallery, scenes and overlays, the table of photos


from hoi.digest import files_digest
from hoi.report import asset_files


def drawing_identity(script, settings):
    """Drawings depend on their templates, too, and on what their scripts share."""
    shared = Path(workflow.basedir) / "workflow" / "scripts" / "frame_artifacts.py"
    return identity(script, settings) | {
        "templates": files_digest(asset_files()),
        "shared": code_digest(str(shared)),
    }


def methods_of(dataset):
    return ("ours",) if dataset == PHOTOS else CONFIG.tables.methods


def frame_chunk(dataset, frame):
    """The chunk that holds a frame. Groups are planned in turn, so only what is asked is read."""
    for group in [PHOTOS] if dataset == PHOTOS else GROUPS:
        for chunk in chunks_of(group):
            if frame in chunk.frame_ids:
                return chunk
    raise WorkflowError(f"There is no frame {frame} in the configured data.")


def page_chunk(wildcards):
    return frame_chunk(wildcards.dataset, wildcards.frame)


def page_inputs(wildcards):
    return artifact_indexes(wildcards.dataset, page_chunk(wildcards))


def page_labels(wildcards):
    """How the report lists a page: by action and frame, in one label.

    One, because Snakemake 9.27's report makes a switch of any further label that has two equally
    frequent values, and then fails where a frame exists for one of them only.
    """
    frames = page_chunk(wildcards).frames
    action = next(frame.action for frame in frames if frame.frame_id == wildcards.frame)
    return {"frame": f"{action} · {wildcards.frame}" if action else wildcards.frame}


def artifact_indexes(dataset, chunk):
    """Indexes of every stage for one chunk, by name."""
    base, name = f"results/{dataset}", f"{chunk.name}.json"
    named = {
        "frames": f"{base}/frames/{name}",
        "detections": f"{base}/detect/{name}",
        "bodies": f"{base}/smplify/{name}",
        "actions": f"{base}/actions/{name}",
        "priors": f"{base}/priors/{name}",
        "body_model": CONFIG.assets.body_model,
        "exemplars": exemplars_of(chunk),
    }
    for method in methods_of(dataset):
        named[f"{method}_objects"] = f"{base}/objectfit/{CONFIG.methods[method].search}/{name}"
        named[f"{method}_joints"] = f"{base}/joint/{method}/{name}"
        if dataset != PHOTOS:
            named[f"{method}_evaluations"] = f"{base}/evaluate/{method}/{name}"
    if dataset != PHOTOS:
        named["truth"] = f"{base}/truth/{name}"
    return named


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
        methods=lambda wildcards: list(methods_of(wildcards.dataset)),
        frames=lambda wildcards: frame_labels([page_chunk(wildcards)]),
        identity=drawing_identity("page", CONFIG.report),
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


def gallery_inputs(wildcards):
    named = {"pages": [f"results/{wildcards.dataset}/pages/{f}.html" for f in shown_frames(wildcards.group)]}
    for chunk in chunks_of(wildcards.group):
        for name, paths in artifact_indexes(wildcards.dataset, chunk).items():
            paths = [paths] if isinstance(paths, str) else paths
            known = named.setdefault(name, [])
            known += [path for path in paths if path not in known]
    return named


rule gallery:
    input:
        unpack(gallery_inputs),
    output:
        report(
            "results/{dataset}/gallery/{group}.html",
            caption="../report/gallery.rst",
            category=GALLERY,
            labels={"group": "{group}"},
        ),
    params:
        methods=lambda wildcards: list(methods_of(wildcards.dataset)),
        shown=lambda wildcards: shown_frames(wildcards.group),
        frames=lambda wildcards: frame_labels(chunks_of(wildcards.group)),
        identity=drawing_identity("gallery", CONFIG.report),
    message:
        "Drawing the gallery of {wildcards.group}"
    log:
        "logs/{dataset}/gallery/{group}.log",
    script:
        "../scripts/gallery.py"


rule scenes:
    # for every frame an overlay picture, and a GLB scene where there is a result
    input:
        unpack(lambda wildcards: artifact_indexes(wildcards.dataset, chunk_named(wildcards.chunk))),
    output:
        "results/{dataset}/scenes/{chunk}.json",
    params:
        method="ours",
        frames=lambda wildcards: frame_labels([chunk_named(wildcards.chunk)]),
        identity=drawing_identity("scenes", CONFIG.report),
    message:
        "Writing the scenes of {wildcards.chunk}"
    log:
        "logs/{dataset}/scenes/{chunk}.log",
    script:
        "../scripts/scenes.py"


# the frame of the README's picture, and its sharpness
OVERVIEW_FRAME = "Date03_Sub04_chairblack_liftreal-t0003.000"
OVERVIEW_CONFIG = CONFIG.report.model_copy(
    update={"image_width": 800, "tile_width": 400, "supersampling": 3}
)


rule overview:
    # the picture of the README; no part of `all`: snakemake -j2 docs/overview.jpg
    input:
        unpack(
            lambda wildcards: artifact_indexes(
                "behave_mini", frame_chunk("behave_mini", OVERVIEW_FRAME)
            )
        ),
    output:
        "docs/overview.jpg",
    params:
        frame=OVERVIEW_FRAME,
        frames=lambda wildcards: frame_labels([frame_chunk("behave_mini", OVERVIEW_FRAME)]),
        method="ours",
        identity=drawing_identity("overview", OVERVIEW_CONFIG),
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
