# Section 3.4, Equation 5: body and object together. Baseline and ablations are methods, too.


rule joint:
    input:
        frames="results/{dataset}/frames/{chunk}.json",
        detections="results/{dataset}/detect/{chunk}.json",
        bodies="results/{dataset}/smplify/{chunk}.json",
        objects=lambda wildcards: (
            f"results/{wildcards.dataset}/objectfit/"
            f"{CONFIG.methods[wildcards.method].search}/{wildcards.chunk}.json"
        ),
        priors=lambda wildcards: (
            f"results/{wildcards.dataset}/{priors_of(wildcards.method)}/{wildcards.chunk}.json"
        ),
        # an oracle is told the truth, no other method ever sees it
        truth=lambda wildcards: (
            []
            if CONFIG.joint_settings(wildcards.method).oracle == "none"
            else f"results/{wildcards.dataset}/truth/{wildcards.chunk}.json"
        ),
        body_model=CONFIG.assets.body_model,
        exemplars=exemplar_files,
        kernels="resources/kernels.ready",
    output:
        index="results/{dataset}/joint/{method}/{chunk}.json",
        seconds="results/{dataset}/joint/{method}/{chunk}.seconds.json",
    params:
        identity=lambda wildcards: stage_identity("joint", CONFIG.joint_settings(wildcards.method)
        ),
    message:
        "Optimising body and object in {wildcards.chunk} ({wildcards.method})"
    log:
        "logs/{dataset}/joint/{method}/{chunk}.log",
    resources:
        mem_mb=2000,
    script:
        "../scripts/joint.py"
