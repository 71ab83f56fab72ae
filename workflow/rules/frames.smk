# Photos and truth enter here once, with their intrinsics, as artifacts.


rule behave_mini:
    # generate the embedded data set, in BEHAVE's own layout
    input:
        assets=BEHAVE_MINI_ASSETS,
    output:
        "resources/behave_mini/chunks/{chunk}.json",
    params:
        frames=lambda wildcards: chunk_named(wildcards.chunk).frame_ids,
        identity=identity("behave_mini", CONFIG.behave_mini_settings),
    message:
        "Generating the frames of {wildcards.chunk} (embedded data set)"
    log:
        "logs/behave_mini/{chunk}.log",
    resources:
        mem_mb=2000,
    script:
        "../scripts/behave_mini.py"


def generated_frames(wildcards):
    if wildcards.dataset == "behave_mini":
        return f"resources/behave_mini/chunks/{wildcards.chunk}.json"
    return []


def reader_settings(wildcards):
    """How the tree is read; the generated one has a single camera and nothing to choose."""
    if wildcards.dataset == "behave_mini":
        return {"root": "resources/behave_mini"}
    # which frames are picked reaches the rule as its frames
    return CONFIG.behave.model_dump(mode="json", exclude={"dates", "every", "frame_list"})


def other_systems(dataset):
    """Files of other systems that are laid into the frames of a data set."""
    return {"other_systems": CONFIG.systems_for(dataset).model_dump(mode="json")}


rule frames:
    # BEHAVE, real or embedded: one reader
    input:
        generated=generated_frames,
    output:
        index="results/{dataset}/frames/{chunk}.json",
        seconds="results/{dataset}/frames/{chunk}.seconds.json",
        truth="results/{dataset}/truth/{chunk}.json",
        truth_seconds="results/{dataset}/truth/{chunk}.seconds.json",
    wildcard_constraints:
        dataset="behave|behave_mini",
    params:
        frames=lambda wildcards: chunk_settings(chunk_named(wildcards.chunk)),
        identity=lambda wildcards: identity("frames", other_systems(wildcards.dataset)),
        reader=reader_settings,
    message:
        "Reading the frames of {wildcards.chunk} ({wildcards.dataset})"
    log:
        "logs/{dataset}/frames/{chunk}.log",
    script:
        "../scripts/frames.py"


def has_unnamed_photos(wildcards):
    return AUTO in chunk_named(wildcards.chunk).categories


def photo_settings(wildcards):
    """Settings of the folder, and of the detector where it has to name objects."""
    naming = None
    if has_unnamed_photos(wildcards):
        naming = {
            "detect": with_labels(CONFIG.detect_photos, OWN_OBJECTS).model_dump(mode="json"),
            "categories": list(KNOWN_CATEGORIES),
        }
    photos = CONFIG.photos.model_dump(mode="json")
    return {"photos": photos, "naming": naming} | other_systems("photos")


rule photos:
    # a folder of photos
    input:
        models=lambda wildcards: (
            "resources/models/all.ready" if has_unnamed_photos(wildcards) else []
        ),
    output:
        index="results/photos/frames/{chunk}.json",
        seconds="results/photos/frames/{chunk}.seconds.json",
    params:
        frames=lambda wildcards: chunk_settings(chunk_named(wildcards.chunk)),
        identity=lambda wildcards: identity("photos", photo_settings(wildcards)),
    message:
        "Reading the photos of {wildcards.chunk}"
    log:
        "logs/photos/frames/{chunk}.log",
    script:
        "../scripts/photos.py"
