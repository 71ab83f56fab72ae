"""What people see: overlays, GLB scenes, one page a frame, a gallery and rendered tables.

Nothing heavy is imported here; take what you need from the modules:

- ``overlay``: pictures of what every stage did (`frame_overlays`, `overlay_sheet`, `thumbnail`)
- ``scene``: metric 3D scenes as GLB, OBJ and PLY (`write_scene_glb`)
- ``page``: one self-contained HTML page a frame (`frame_page`)
- ``gallery``: the index of all frames and the table of failures by cause (`gallery_page`)
- ``tables``: the tidy results in the paper's layout, as text, HTML and LaTeX
"""

from pathlib import Path

from hoi.report.config import ReportConfig

__all__ = ["ReportConfig", "asset_files"]


def asset_files() -> list[Path]:
    """Templates, style sheets, scripts and data that the output depends on besides the code."""
    here = Path(__file__).parent
    return sorted([*(here / "templates").iterdir(), *here.glob("*.csv")])
