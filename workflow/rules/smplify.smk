# Section 3.1, Equation 1: fit the body to the keypoints


rule smplify:
    input:
        frames="results/{dataset}/frames/{chunk}.json",
        detections="results/{dataset}/detect/{chunk}.json",
        body_model=CONFIG.assets.body_model,
        # the poses of images cannot be the prior by which they are found
        pose_database=lambda wildcards: (
            POSE_DATABASE if wildcards.dataset == INTERACTIONS else CONFIG.assets.pose_database
        ),
    output:
        index="results/{dataset}/smplify/{chunk}.json",
        seconds="results/{dataset}/smplify/{chunk}.seconds.json",
    params:
        identity=stage_identity("smplify", CONFIG.smplify),
    message:
        "Fitting bodies in {wildcards.chunk}"
    log:
        "logs/{dataset}/smplify/{chunk}.log",
    resources:
        mem_mb=2000,
    script:
        "../scripts/smplify.py"
