"""Read a chunk of a folder of photos."""

from chunk_job import logged

from hoi.artifacts import Frame
from hoi.chunks import write_chunk
from hoi.datasets.photos import list_photos, read_photo
from hoi.datasets.photos_config import PhotosConfig
from hoi.digest import json_digest
from hoi.memo import Memo

config = PhotosConfig(**snakemake.params.identity["settings"])
photos = {photo.frame_id: photo for photo in list_photos(config)}
frames = {frame["frame_id"]: frame for frame in snakemake.params.frames}
with logged(snakemake):
    write_chunk(
        "photos",
        Frame,
        list(frames),
        lambda frame_id: read_photo(config, photos[frame_id]),
        {
            key: json_digest(["photos", frame, snakemake.params.identity])
            for key, frame in frames.items()
        },
        snakemake.output.index,
        snakemake.output.seconds,
        Memo(snakemake.config["memo"]),
    )
