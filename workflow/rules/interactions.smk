# Section 3.2, building the interaction database: a pose database from images that were searched
# for. No part of `all`: snakemake -j2 results/interactions/database.npz


rule interaction_images:
    # read, and drop what is too small
    output:
        index="results/interactions/frames/{chunk}.json",
        seconds="results/interactions/frames/{chunk}.seconds.json",
    params:
        frames=lambda wildcards: chunk_settings(chunk_named(wildcards.chunk)),
        categories=list(KNOWN_CATEGORIES),
        identity=identity("interaction_images", CONFIG.interactions),
    message:
        "Reading the images of {wildcards.chunk}"
    log:
        "logs/interactions/frames/{chunk}.log",
    script:
        "../scripts/interaction_images.py"


def interaction_detect_settings(wildcards):
    settings = CONFIG.detect_settings(INTERACTIONS)
    return with_labels(settings, own_categories(chunk_named(wildcards.chunk)))


use rule detect as detect_candidates with:
    # everything that is seen; which image counts is the filter's business
    input:
        frames="results/interactions/frames/{chunk}.json",
        models=models_of(CONFIG.detect_settings(INTERACTIONS)),
    output:
        index="results/interactions/candidates/{chunk}.json",
        seconds="results/interactions/candidates/{chunk}.seconds.json",
    params:
        identity=lambda wildcards: stage_identity("detect", interaction_detect_settings(wildcards)),
    log:
        "logs/interactions/candidates/{chunk}.log",


rule interaction_filter:
    # keep one person with one object; what is dropped here costs no body fit
    input:
        detections="results/interactions/candidates/{chunk}.json",
    output:
        index="results/interactions/detect/{chunk}.json",
        seconds="results/interactions/detect/{chunk}.seconds.json",
    params:
        identity=identity("interaction_filter", CONFIG.interactions),
    message:
        "Filtering {wildcards.chunk}"
    log:
        "logs/interactions/detect/{chunk}.log",
    script:
        "../scripts/interaction_filter.py"


# results/interactions/detect is filtered, other data sets' detections are not
ruleorder: interaction_filter > detect


rule interaction_database:
    input:
        frames=lambda wildcards: indexes(INTERACTIONS, "frames"),
        detections=lambda wildcards: indexes(INTERACTIONS, "detect"),
        bodies=lambda wildcards: indexes(INTERACTIONS, "smplify"),
        package=POSE_DATABASE,
    output:
        database="results/interactions/database.npz",
        counts=report(
            "results/interactions/counts.csv",
            caption="../report/interactions.rst",
            category=TABLES,
            labels={"table": "interaction images", "form": "csv"},
        ),
        images="results/interactions/images.csv",
    params:
        frames=lambda wildcards: [
            frame for chunk in chunks_of(INTERACTIONS) for frame in chunk_settings(chunk)
        ],
        identity=identity("interaction_database", CONFIG.interactions),
    message:
        "Collecting the interaction database"
    log:
        "logs/interactions/database.log",
    script:
        "../scripts/interaction_database.py"
