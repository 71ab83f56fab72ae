# Section 3.2: the action of the nearest pose in the database


rule actions:
    input:
        frames="results/{dataset}/frames/{chunk}.json",
        bodies="results/{dataset}/smplify/{chunk}.json",
        pose_database=lambda wildcards: pose_database_of(chunk_named(wildcards.chunk)),
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


rule table_actions:
    # how well the pose database tells its own actions apart; independent of any frame
    input:
        pose_database=CONFIG.assets.pose_database,
        action_space=ACTION_SPACE,
        body_model=CONFIG.assets.body_model,
    output:
        csv=report(
            "results/actions.csv",
            caption="../report/actions.rst",
            category=TABLES,
            labels={"table": "actions", "form": "csv"},
        ),
        html=report(
            "results/actions.html",
            caption="../report/actions.rst",
            category=TABLES,
            labels={"table": "actions", "form": "as a table"},
        ),
        confusion="results/actions.confusion.csv",
        queries="results/actions.queries.csv",
    params:
        identity=identity("table_actions", CONFIG.actions),
        report=CONFIG.report.model_dump(mode="json"),
    message:
        "Looking every pose of the database up among the others"
    log:
        "logs/actions.log",
    script:
        "../scripts/table_actions.py"
