# Section 4.2: how often the detectors fail, also where the tables use the data set's own masks

REGISTRY = CONFIG.detect.model_copy(update={"masks": "registry", "keypoints": "registry"})


use rule detect as detect_registry with:
    input:
        frames="results/{dataset}/frames/{chunk}.json",
        models=models_of(REGISTRY),
    output:
        index="results/{dataset}/detect_registry/{chunk}.json",
        seconds="results/{dataset}/detect_registry/{chunk}.seconds.json",
    params:
        identity=stage_identity("detect", REGISTRY),
    log:
        "logs/{dataset}/detect_registry/{chunk}.log",


rule table_detection:
    input:
        frames=lambda _: [path for group in groups_here() for path in indexes(group, "frames")],
        detections=lambda _: [
            path for group in groups_here() for path in indexes(group, "detect_registry")
        ],
    output:
        csv=report(
            "results/detection.csv",
            caption="../report/detection.rst",
            category=TABLES,
            labels={"table": "detection", "form": "csv"},
        ),
        html=report(
            "results/detection.html",
            caption="../report/detection.rst",
            category=TABLES,
            labels={"table": "detection", "form": "as a table"},
        ),
    params:
        dataset=DATASET,
        split=CONFIG.split,
        identity=identity("table_detection", REGISTRY),
    message:
        "Collecting results/detection.csv"
    log:
        "logs/detection.log",
    script:
        "../scripts/table_detection.py"


rule masks:
    # every way to cut out the object, from the box that was found and from the true one
    input:
        frames="results/{dataset}/frames/{chunk}.json",
        detections="results/{dataset}/detect_registry/{chunk}.json",
        models=models_of(REGISTRY),
    output:
        "results/{dataset}/masks/{chunk}.csv",
    params:
        identity=stage_identity("masks", REGISTRY),
    message:
        "Comparing object masks of {wildcards.chunk}"
    log:
        "logs/{dataset}/masks/{chunk}.log",
    script:
        "../scripts/masks.py"


rule table_masks:
    input:
        lambda _: [
            path.replace(".json", ".csv")
            for group in groups_here()
            for path in indexes(group, "masks")
        ],
    output:
        csv=report(
            "results/masks.csv",
            caption="../report/masks.rst",
            category=TABLES,
            labels={"table": "object masks", "form": "csv"},
        ),
        html=report(
            "results/masks.html",
            caption="../report/masks.rst",
            category=TABLES,
            labels={"table": "object masks", "form": "as a table"},
        ),
    params:
        dataset=DATASET,
        split=CONFIG.split,
        identity=identity("table_masks", {}),
    message:
        "Collecting results/masks.csv"
    log:
        "logs/masks.log",
    script:
        "../scripts/table_masks.py"
