# Section 4.2: Procrustes on the body, Chamfer of both, collected into the paper's tables


rule evaluate:
    input:
        frames="results/{dataset}/frames/{chunk}.json",
        truth="results/{dataset}/truth/{chunk}.json",
        joints="results/{dataset}/joint/{method}/{chunk}.json",
        body_model=CONFIG.assets.body_model,
    output:
        index="results/{dataset}/evaluate/{method}/{chunk}.json",
        seconds="results/{dataset}/evaluate/{method}/{chunk}.seconds.json",
    params:
        identity=stage_identity("evaluate", CONFIG.evaluate),
    message:
        "Measuring {wildcards.chunk} ({wildcards.method})"
    log:
        "logs/{dataset}/evaluate/{method}/{chunk}.log",
    script:
        "../scripts/evaluate.py"


def table_inputs(group, methods):
    """Evaluations and time sheets by method."""
    named = {}
    for method in methods:
        named[method] = indexes(group, f"evaluate/{method}")
        named[f"{method}_seconds"] = seconds(group, stages_of(method))
    return named


def table_params(group, methods, ablation=False, script="table"):
    shared = Path(workflow.basedir) / "workflow" / "scripts" / "evaluations.py"
    return {
        "ablation": ablation,
        "category": group,
        "methods": list(methods),
        "masks": CONFIG.detect_settings(dataset_of(group)).masks,
        "failure_cm": CONFIG.evaluate.failure_cm,
        "align": CONFIG.evaluate.align,
        "also": [name for name in CONFIG.evaluate.also if name != CONFIG.evaluate.align],
        "frames": frame_labels(chunks_of(group)),
        "identity": json_digest([drawing_identity(script, {}), code_digest(str(shared))]),
    }


rule table:
    input:
        # listed only when the table is asked for: planning reads the data set
        unpack(lambda wildcards: table_inputs(wildcards.group, CONFIG.tables.methods)),
    output:
        csv=report(
            "results/behave_{group}.csv",
            caption="../report/table.rst",
            category=TABLES,
            labels={"table": "{group}", "form": "csv"},
        ),
        html=report(
            "results/behave_{group}.html",
            caption="../report/table.rst",
            category=TABLES,
            labels={"table": "{group}", "form": "as a table"},
        ),
        tex="results/behave_{group}.tex",
        frames="results/behave_{group}.frames.csv",
        protocols="results/behave_{group}.protocols.csv",
        contacts="results/behave_{group}.contacts.csv",
        paper="results/behave_{group}.paper.csv",
    wildcard_constraints:
        group="|".join(GROUPS),
    params:
        table=lambda wildcards: table_params(wildcards.group, CONFIG.tables.methods),
    message:
        "Collecting results/behave_{wildcards.group}.csv"
    log:
        "logs/behave_{group}.log",
    script:
        "../scripts/table.py"


rule ablation:
    input:
        unpack(lambda _: table_inputs(CONFIG.tables.ablation_group, CONFIG.tables.ablation)),
    output:
        csv=report(
            "results/ablation.csv",
            caption="../report/ablation.rst",
            category=TABLES,
            labels={"table": f"{CONFIG.tables.ablation_group}, ablation", "form": "csv"},
        ),
        html=report(
            "results/ablation.html",
            caption="../report/ablation.rst",
            category=TABLES,
            labels={"table": f"{CONFIG.tables.ablation_group}, ablation", "form": "as a table"},
        ),
        tex="results/ablation.tex",
        frames="results/ablation.frames.csv",
        protocols="results/ablation.protocols.csv",
        contacts="results/ablation.contacts.csv",
        paper="results/ablation.paper.csv",
    params:
        table=lambda wildcards: table_params(
            CONFIG.tables.ablation_group, CONFIG.tables.ablation, ablation=True
        ),
    message:
        "Collecting results/ablation.csv"
    log:
        "logs/ablation.log",
    script:
        "../scripts/table.py"
