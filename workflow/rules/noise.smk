# Section 4.1: what wrong answers of a language model cost, frame by frame against right ones


rule prior_noise:
    input:
        unpack(lambda _: table_inputs(CONFIG.tables.ablation_group, CONFIG.tables.prior_noise)),
    output:
        csv="results/prior_noise.csv",
        paired="results/prior_noise.paired.csv",
        frames="results/prior_noise.frames.csv",
        picture="results/prior_noise.png",
        html="results/prior_noise.html",
    params:
        table=lambda wildcards: table_params(
            CONFIG.tables.ablation_group, CONFIG.tables.prior_noise, True, "accuracy"
        ),
    message:
        "Comparing right and wrong answers frame by frame"
    log:
        "logs/prior_noise.log",
    script:
        "../scripts/accuracy.py"
