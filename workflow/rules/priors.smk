# Section 3.3: what the language model says of the object and the action

from hoi.digest import files_digest
from hoi.priors.config import REACHING

# who was asked, and how, shows in the tables; what follows depends on the answers alone
LOOKUP = CONFIG.priors.model_dump(mode="json", exclude={"source", "llm"})


def asking_identity():
    """What the answers of a language model depend on: not on where its server is."""
    from hoi.priors.answered import recordings_digest
    from hoi.priors.prompts import PROMPTS

    asked = CONFIG.priors.llm
    # while answers are being recorded they are no reason to ask again
    replayed = asked.mode == "replay" and CONFIG.priors.source == "llm"
    return identity(
        "prior_tables", asked.model_dump(mode="json", exclude={*REACHING, "recordings"})
    ) | {
        "prompts": files_digest(PROMPTS.glob("*.txt")),
        "answers": recordings_digest(asked) if replayed else "recorded by this run",
    }


def study_identity():
    """Judges, rules, and what the judges are recorded to have said."""
    from hoi.priors.answered import recordings_digest

    judges = CONFIG.prior_study.judges
    settings = CONFIG.prior_study.model_dump(mode="json", exclude={"judges"})
    asked = [j.model_dump(mode="json", exclude={*REACHING, "recordings"}) for j in judges]
    return identity("prior_study", settings | {"judges": asked}) | {
        "answers": [recordings_digest(judge) for judge in judges]
    }


rule prior_tables:
    # Section 3.3: answers of a language model, replayed or asked for, as tables
    input:
        recorded=RECORDED_PRIORS,
    output:
        tables=ASKED_PRIORS,
        rejected="resources/priors/rejected.csv",
    params:
        identity=lambda _: asking_identity(),
    message:
        "Collecting the answers of {CONFIG.priors.llm.model}"
    log:
        "logs/priors/tables.log",
    resources:
        network=int(CONFIG.priors.llm.mode != "replay"),
    script:
        "../scripts/prior_tables.py"


rule prior_study:
    # Section 4.1: votes of people and models on the labels; agreement; sizes by axis
    input:
        recorded=RECORDED_PRIORS,
        ratings=list(CONFIG.prior_study.ratings),
    output:
        study=report(
            "results/priors.csv",
            caption="../report/priors.rst",
            category=TABLES,
            labels={"table": "priors", "form": "csv"},
        ),
        agreement="results/prior_agreement.csv",
        sizes="results/prior_sizes.csv",
    params:
        identity=lambda _: study_identity(),
    message:
        "Judging the priors"
    log:
        "logs/priors/study.log",
    script:
        "../scripts/prior_study.py"


rule priors:
    input:
        frames="results/{dataset}/frames/{chunk}.json",
        actions="results/{dataset}/actions/{chunk}.json",
        answers=lambda wildcards: OWN_PRIOR_TABLES if shows_own(wildcards) else PRIOR_TABLES,
    output:
        index="results/{dataset}/priors/{chunk}.json",
        seconds="results/{dataset}/priors/{chunk}.seconds.json",
    params:
        identity=stage_identity("priors", LOOKUP),
    message:
        "Looking up priors for {wildcards.chunk}"
    log:
        "logs/{dataset}/priors/{chunk}.log",
    script:
        "../scripts/priors.py"


use rule priors as prior_variant with:
    # the same, looked up in another way: for studies
    output:
        index="results/{dataset}/priors/{variant}/{chunk}.json",
        seconds="results/{dataset}/priors/{variant}/{chunk}.seconds.json",
    params:
        identity=lambda wildcards: stage_identity(
            "priors", CONFIG.prior_variants[wildcards.variant]
        ),
    log:
        "logs/{dataset}/priors/{variant}/{chunk}.log",
