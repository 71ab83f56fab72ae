# Every method on the same frames, against one of them, with intervals: where the error comes from


rule accuracy:
    input:
        unpack(lambda _: table_inputs(CONFIG.tables.ablation_group, CONFIG.tables.accuracy)),
    output:
        csv="results/accuracy.csv",
        paired="results/accuracy.paired.csv",
        frames="results/accuracy.frames.csv",
        picture=report(
            "results/accuracy.png",
            caption="../report/accuracy.rst",
            category=TABLES,
            labels={"table": "accuracy", "form": "as a picture"},
        ),
        html=report(
            "results/accuracy.html",
            caption="../report/accuracy.rst",
            category=TABLES,
            labels={"table": "accuracy", "form": "as a table"},
        ),
    params:
        table=lambda wildcards: table_params(
            CONFIG.tables.ablation_group, CONFIG.tables.accuracy, True, "accuracy"
        ),
    message:
        "Comparing the methods frame by frame"
    log:
        "logs/accuracy.log",
    script:
        "../scripts/accuracy.py"
