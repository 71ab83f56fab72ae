# Section 3.1: the person, the object, their masks, the keypoints


def models_marker(wildcards):
    which = CONFIG.detect_settings(wildcards.dataset).needed_models
    return [] if which == "none" else f"resources/models/{which}.ready"


rule detect:
    input:
        frames="results/{dataset}/frames/{chunk}.json",
        models=models_marker,
    output:
        index="results/{dataset}/detect/{chunk}.json",
        seconds="results/{dataset}/detect/{chunk}.seconds.json",
    params:
        identity=lambda wildcards: stage_identity("detect", CONFIG.detect_settings(wildcards.dataset)
        ),
    message:
        "Detecting people and objects in {wildcards.chunk}"
    log:
        "logs/{dataset}/detect/{chunk}.log",
    resources:
        mem_mb=2000,
    script:
        "../scripts/detect.py"
