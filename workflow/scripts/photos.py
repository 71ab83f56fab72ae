"""Read a chunk of a folder of photos; name the object where nobody did."""

from functools import cache
from pathlib import Path

from chunk_job import logged

from hoi.artifacts import Frame
from hoi.chunks import write_chunk
from hoi.datasets.photos import list_photos, read_photo
from hoi.datasets.photos_config import AUTO, PhotosConfig
from hoi.digest import json_digest
from hoi.errors import FrameFailure
from hoi.memo import Memo
from hoi.readers.attach import attach, upright_size
from hoi.readers.config import OtherSystems
from hoi.readers.paths import FrameNames

settings = snakemake.params.identity["settings"]
config = PhotosConfig(**settings["photos"])
others = OtherSystems(**settings["other_systems"])
folder = Path(config.folder).expanduser()
photos = {photo.frame_id: photo for photo in list_photos(config)}
frames = {frame["frame_id"]: frame for frame in snakemake.params.frames}


@cache
def namer():
    from hoi.detect.config import DetectConfig
    from hoi.detect.naming import ObjectNamer

    naming = settings["naming"]
    detect = DetectConfig(**naming["detect"])
    return ObjectNamer(detect, naming["categories"], Path("resources/models"))


def read(frame_id: str) -> Frame:
    photo, category = photos[frame_id], frames[frame_id]["category"]
    known = {"category": category, "object_name": photo.category}
    try:
        frame = read_photo(config, photo)
        if others != OtherSystems():
            names = FrameNames(frame_id, photo.file)
            frame = attach(frame, others, names, folder, upright_size(folder / photo.file))
    except FrameFailure as failure:
        told = {"dataset": "photos", "source": photo.file} | known
        return Frame.failed(frame_id, failure, "photos").model_copy(update=told)
    if category == AUTO and frame.image is not None:
        # where even the detector finds no name, its own stage says what it saw
        known["category"] = namer()(frame.image, frame.hints) or AUTO
    return frame.model_copy(update=known)


with logged(snakemake):
    write_chunk(
        "photos",
        Frame,
        list(frames),
        read,
        {
            key: json_digest(["photos", frame, snakemake.params.identity])
            for key, frame in frames.items()
        },
        snakemake.output.index,
        snakemake.output.seconds,
        Memo(snakemake.config["memo"]),
    )
