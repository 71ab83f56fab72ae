# The recipe of the object segmenter (docs/segmenter.md). Nothing else needs it: the weights ship.
#
#   snakemake -j2 results/segmenter.csv           all of it, then the new weights beside the shipped
#   snakemake -j2 results/segmenter_shipped.csv   only what measuring the shipped weights takes

RECIPE = CONFIG.segmenter
SEGMENTER = "resources/segmenter"


def picture_parts(split):
    """Markers of the jobs that render one split."""
    count = RECIPE.scenes.scenes if split == "train" else RECIPE.scenes.validation
    parts = -(-count // RECIPE.scenes.chunk)
    return [f"{SEGMENTER}/pictures/{split}-{part:03d}.json" for part in range(parts)]


rule segmenter_meshes:
    # textured models of Debian's sweethome3d-furniture, CC0 and CC BY packs only
    output:
        f"{SEGMENTER}/meshes/index.json",
    params:
        identity=identity(
            "segmenter_meshes",
            {"packs": RECIPE.packs, "held_out_share": RECIPE.scenes.held_out_share},
        ),
    message:
        "Reading the meshes of the segmenter's training scenes"
    log:
        "logs/segmenter/meshes.log",
    resources:
        network=1,
    script:
        "../scripts/segmenter_meshes.py"


rule segmenter_pictures:
    # rendered photos; what an interrupted job has rendered is kept
    input:
        meshes=f"{SEGMENTER}/meshes/index.json",
        models="resources/models/all.ready",
        body=CONFIG.assets.body_model,
        poses=CONFIG.assets.pose_database,
    output:
        f"{SEGMENTER}/pictures/{{split}}-{{part}}.json",
    wildcard_constraints:
        split="train|validation",
        part=r"\d{3}",
    params:
        identity=identity("segmenter_pictures", RECIPE.scenes) | {"seed": RECIPE.seed},
    message:
        "Rendering {wildcards.split} pictures, part {wildcards.part}"
    log:
        "logs/segmenter/{split}-{part}.log",
    resources:
        mem_mb=2500,
    script:
        "../scripts/segmenter_pictures.py"


rule segmenter_train:
    # goes on from its last checkpoint when it was interrupted
    input:
        pictures=picture_parts("train"),
        models="resources/models/all.ready",
    output:
        f"{SEGMENTER}/network.pt",
    params:
        identity=identity("segmenter_train", RECIPE.train) | {"seed": RECIPE.seed},
    message:
        "Training the object segmenter"
    log:
        "logs/segmenter/train.log",
    resources:
        mem_mb=4000,
    script:
        "../scripts/segmenter_train.py"


rule segmenter_export:
    input:
        network=f"{SEGMENTER}/network.pt",
    output:
        f"{SEGMENTER}/segmenter.onnx.gz",
    params:
        identity=identity("segmenter_export", {}),
    message:
        "Exporting the object segmenter"
    log:
        "logs/segmenter/export.log",
    script:
        "../scripts/segmenter_export.py"


def weights_of(wildcards):
    trained = wildcards.weights == "trained"
    return f"{SEGMENTER}/segmenter.onnx.gz" if trained else SEGMENTER_WEIGHTS


rule segmenter_evaluate:
    # on meshes and bodies that training never sees, from detected boxes, beside GrabCut
    input:
        weights=weights_of,
        pictures=picture_parts("validation"),
        models="resources/models/all.ready",
    output:
        summary="results/segmenter_{weights}.csv",
        pictures="results/segmenter/{weights}.csv",
    wildcard_constraints:
        weights="trained|shipped",
    params:
        identity=identity(
            "segmenter_evaluate", {"minimum_box_overlap": RECIPE.minimum_box_overlap}
        ),
    message:
        "Measuring the {wildcards.weights} weights of the object segmenter"
    log:
        "logs/segmenter/evaluate-{weights}.log",
    script:
        "../scripts/segmenter_evaluate.py"


rule segmenter:
    input:
        "results/segmenter_trained.csv",
        "results/segmenter_shipped.csv",
    output:
        "results/segmenter.csv",
    message:
        "Collecting results/segmenter.csv"
    log:
        "logs/segmenter/table.log",
    params:
        identity=identity("segmenter_table", {}),
    script:
        "../scripts/segmenter_table.py"
