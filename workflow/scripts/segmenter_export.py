"""Write trained weights in the form that ships."""

from pathlib import Path

from chunk_job import logged

from hoi.segmenter.export import write_weights
from hoi.segmenter.network import SegmentationNetwork
from hoi.segmenter.training import read_weights

with logged(snakemake):
    network = SegmentationNetwork()
    network.load_state_dict(read_weights(Path(snakemake.input.network)))
    write_weights(network, snakemake.output[0])
