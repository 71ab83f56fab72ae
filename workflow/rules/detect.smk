# Section 3.1: the person, the object, their masks, the keypoints


SEGMENTER_WEIGHTS = "src/hoi/data/segmenter/segmenter.onnx.gz"


def models_of(settings):
    """Marker of the fetched model files, and the shipped weights where a mask is made of a box."""
    which = settings.needed_models
    segments = settings.masks != "given" and settings.object_masks == "segmenter"
    fetched = [] if which == "none" else [f"resources/models/{which}.ready"]
    return fetched + [SEGMENTER_WEIGHTS] * segments


rule detect:
    input:
        frames="results/{dataset}/frames/{chunk}.json",
        models=lambda wildcards: models_of(CONFIG.detect_settings(wildcards.dataset)),
    output:
        index="results/{dataset}/detect/{chunk}.json",
        seconds="results/{dataset}/detect/{chunk}.seconds.json",
    params:
        identity=lambda wildcards: stage_identity("detect", detect_settings(wildcards)),
    message:
        "Detecting people and objects in {wildcards.chunk}"
    log:
        "logs/{dataset}/detect/{chunk}.log",
    resources:
        mem_mb=2000,
    script:
        "../scripts/detect.py"
