"""The parametric body: one linear-blend-skinning model for the embedded body and for SMPL files.

Heavy names (torch) are imported on first use, so that light code may import the package.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hoi.body.model import BodyModel, BodyOutput
    from hoi.body.parts import part_vertices

__all__ = ["DEFAULT_BODY", "BodyModel", "BodyOutput", "part_vertices"]

#: The embedded CC0 body (``python -m hoi.body.build`` makes it).
DEFAULT_BODY: Path = Path(__file__).parent.parent / "data" / "body" / "neutral.npz"

_HOME = {
    "BodyModel": "hoi.body.model",
    "BodyOutput": "hoi.body.model",
    "part_vertices": "hoi.body.parts",
}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
