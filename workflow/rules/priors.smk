# Section 3.3: what the language model says of the object and the action

# who was asked, and how, shows in the tables; what follows depends on the answers alone
LOOKUP = CONFIG.priors.model_dump(mode="json", exclude={"source", "llm"})


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
