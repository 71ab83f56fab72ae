# hoi: one photo of a person with an object -> a metric 3D scene, and the paper's tables.
#
#   snakemake -j2 results/behave_chair.csv     the main table
#   snakemake -j2 results/photos.csv           your own photos
#   snakemake -j2                              everything that results/index.html shows
#   snakemake --report report.html             ... and the report itself
#
# One rule file a stage, in the order of the paper. Settings: config/config.yaml.

from snakemake.utils import min_version

min_version("9.27")


configfile: "config/config.yaml"


include: "workflow/rules/common.smk"
include: "workflow/rules/assets.smk"
include: "workflow/rules/frames.smk"
include: "workflow/rules/detect.smk"
include: "workflow/rules/detection.smk"
include: "workflow/rules/segmenter.smk"
include: "workflow/rules/smplify.smk"
include: "workflow/rules/objectfit.smk"
include: "workflow/rules/actions.smk"
include: "workflow/rules/priors.smk"
include: "workflow/rules/joint.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/evaluate.smk"
include: "workflow/rules/interactions.smk"
include: "workflow/rules/accuracy.smk"
include: "workflow/rules/noise.smk"


report: "workflow/report/workflow.rst"


rule all:
    default_target: True
    input:
        "results/behave_chair.csv",
        "results/ablation.csv",
        "results/priors.csv",
        "results/actions.csv",
        "results/index.html",
        [gallery_of(group) for group in CONFIG.report.groups],
