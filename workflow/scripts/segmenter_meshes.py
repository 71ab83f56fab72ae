"""Read the meshes of the segmenter's training scenes once."""

from pathlib import Path

from chunk_job import logged

from hoi.segmenter.meshes import build_store, fetch_packs

settings = snakemake.params.identity["settings"]
folder = Path(snakemake.output[0]).parent
with logged(snakemake):
    packs = settings["packs"]
    packs = Path(packs).expanduser() if packs else fetch_packs(folder.parent / "packs")
    build_store(packs, folder, settings["held_out_share"])
