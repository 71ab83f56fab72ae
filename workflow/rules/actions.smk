# Section 3.2: the action of the nearest pose in the database


rule actions:
    input:
        frames="results/{dataset}/frames/{chunk}.json",
        bodies="results/{dataset}/smplify/{chunk}.json",
        pose_database=lambda wildcards: (
            OWN_POSES if shows_own(wildcards) else CONFIG.assets.pose_database
        ),
        action_space=lambda wildcards: (
            OWN_ACTION_SPACE if shows_own(wildcards) else ACTION_SPACE
        ),
    output:
        index="results/{dataset}/actions/{chunk}.json",
        seconds="results/{dataset}/actions/{chunk}.seconds.json",
    params:
        identity=stage_identity("actions", CONFIG.actions),
    message:
        "Recognising actions in {wildcards.chunk}"
    log:
        "logs/{dataset}/actions/{chunk}.log",
    script:
        "../scripts/actions.py"
