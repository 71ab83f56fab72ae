# What people look at: a page a frame, a gallery, scenes and overlays, the table of photos


from hoi.digest import files_digest
from hoi.report import asset_files


def drawing_identity(script, settings):
    """Drawings depend on their templates, too."""
    return identity(script, settings) | {"templates": files_digest(asset_files())}


def methods_of(dataset):
    return ("ours",) if dataset == PHOTOS else CONFIG.tables.methods


def frame_chunk(frame, groups=(*GROUPS, PHOTOS)):
    """The chunk that holds a frame. Groups are planned in turn, so only what is asked is read."""
    for group in groups:
        for chunk in chunks_of(group):
            if frame in chunk.frame_ids:
                return chunk
    raise WorkflowError(f"There is no frame {frame} in the configured data.")


def page_inputs(wildcards):
    chunk = frame_chunk(wildcards.frame, [PHOTOS] if wildcards.dataset == PHOTOS else GROUPS)
    return artifact_indexes(wildcards.dataset, chunk)


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
            category="Frames",
            labels={"frame": "{frame}"},
        ),
    params:
        methods=lambda wildcards: list(methods_of(wildcards.dataset)),
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
            category="Gallery",
            labels={"group": "{group}"},
        ),
    params:
        methods=lambda wildcards: list(methods_of(wildcards.dataset)),
        shown=lambda wildcards: shown_frames(wildcards.group),
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
        identity=drawing_identity("scenes", CONFIG.report),
    message:
        "Writing the scenes of {wildcards.chunk}"
    log:
        "logs/{dataset}/scenes/{chunk}.log",
    script:
        "../scripts/scenes.py"


rule table_photos:
    # your own photos: one row each, with the reason where there is no result
    input:
        joints=lambda wildcards: indexes(PHOTOS, "joint/ours"),
        bodies=lambda wildcards: indexes(PHOTOS, "smplify"),
        scenes=lambda wildcards: indexes(PHOTOS, "scenes"),
        frames=lambda wildcards: indexes(PHOTOS, "frames"),
        gallery=lambda wildcards: gallery_of(PHOTOS),
        seconds=lambda wildcards: seconds(PHOTOS, stages_of("ours")),
    output:
        report(
            "results/photos.csv",
            caption="../report/photos.rst",
            category="Tables",
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
