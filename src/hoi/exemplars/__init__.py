"""Object exemplars: metric, watertight, part-labelled meshes, 20 a category [paper 3.5]."""

from hoi.exemplars.library import (
    Exemplar,
    SurfaceSamples,
    library_path,
    load_library,
    load_library_file,
    sample_parts,
    save_library,
)

__all__ = [
    "Exemplar",
    "SurfaceSamples",
    "library_path",
    "load_library",
    "load_library_file",
    "sample_parts",
    "save_library",
]
