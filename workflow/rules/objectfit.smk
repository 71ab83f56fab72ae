# Section 3.1: exemplars and their 6-DoF poses by differentiable silhouette


rule objectfit:
    input:
        frames="results/{dataset}/frames/{chunk}.json",
        detections="results/{dataset}/detect/{chunk}.json",
        exemplars=exemplar_files,
        kernels="resources/kernels.ready",
    output:
        index="results/{dataset}/objectfit/{search}/{chunk}.json",
        seconds="results/{dataset}/objectfit/{search}/{chunk}.seconds.json",
    params:
        identity=lambda wildcards: stage_identity("objectfit", CONFIG.objectfit[wildcards.search]
        ),
    message:
        "Searching object poses in {wildcards.chunk} ({wildcards.search})"
    log:
        "logs/{dataset}/objectfit/{search}/{chunk}.log",
    resources:
        mem_mb=2000,
    script:
        "../scripts/objectfit.py"
