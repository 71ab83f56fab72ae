"""The interactive 3D view: three.js as bundled with trimesh, embedded compressed in a page.

trimesh (MIT) ships one HTML template that contains three.js r140 with its trackball controls and
glTF loader (MIT) as classic scripts, made for offline notebooks. The page takes these scripts out
of it, so nothing is vendored here and nothing is fetched when a page is opened.
"""

from __future__ import annotations

import base64
import gzip
import io
import zipfile
from functools import cache

from hoi.errors import AssetError

_START = "<script>"
_END = "var camera,controls,scene,renderer,tracklight"  # where trimesh's own page code begins


@cache
def three_js() -> str:
    """The scripts of three.js, its trackball controls and glTF loader.

    Raises AssetError when the installed trimesh no longer ships them in the known form.
    """
    import trimesh
    from trimesh import resources

    try:
        with zipfile.ZipFile(io.BytesIO(resources.get_bytes("templates/viewer.zip"))) as archive:
            template = archive.read("viewer.html.template").decode("utf-8")
        start = template.index(_START) + len(_START)
        script = template[start : template.index(_END)]
    except (KeyError, ValueError, OSError, zipfile.BadZipFile) as error:
        raise AssetError(
            f"trimesh {trimesh.__version__} does not hold the 3D viewer in the form known from "
            "5.2: install trimesh 5.2 or report this"
        ) from error
    if not all(name in script for name in ("TrackballControls", "GLTFLoader", "WebGLRenderer")):
        raise AssetError(f"the 3D viewer of trimesh {trimesh.__version__} lacks parts of three.js")
    return script


def packed(data: bytes) -> str:
    """gzip and base64 for a page's script to unpack; equal bytes give equal text."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode("ascii")
