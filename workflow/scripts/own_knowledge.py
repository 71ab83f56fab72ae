"""Poses, actions, sizes and contacts with those of the user's own objects added."""

from pathlib import Path

from hoi.own_objects.description import own_objects
from hoi.own_objects.merging import merge_all

merge_all(
    own_objects(snakemake.params.folder),
    snakemake.input.pose_database,
    snakemake.input.action_space,
    snakemake.input.tables,
    snakemake.output.pose_database,
    snakemake.output.action_space,
    Path(snakemake.output.tables[0]).parent,
)
