"""The templates of the report and what they may call. Everything they print is escaped."""

from __future__ import annotations

import base64
import re
from functools import cache

import numpy as np

from hoi.report.config import ReportConfig
from hoi.report.labels import method_label
from hoi.report.overlay import webp

_CURVE_SIZE = (150.0, 44.0)


@cache
def environment():
    """The Jinja environment of the package's templates; undefined names are errors."""
    import jinja2

    found = jinja2.Environment(
        loader=jinja2.PackageLoader("hoi.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.filters["curve"] = curve_points
    found.filters["losses"] = loss_symbols
    found.filters["breakable"] = breakable
    found.filters["method"] = lambda name: loss_symbols(method_label(name))
    found.filters["method_text"] = lambda name: method_label(name)
    return found


def render(template: str, **values: object) -> str:
    """The text of a template of this package."""
    return environment().get_template(template).render(**values)


def source(name: str) -> str:
    """The unrendered text of a style sheet or script of this package."""
    found = environment()
    assert found.loader is not None
    return found.loader.get_source(found, name)[0]


def image_url(image: np.ndarray, config: ReportConfig) -> str:
    """A ``data:`` URL with an RGB picture as WebP, half as large as a JPEG of that quality."""
    encoded = base64.b64encode(webp(image, config.jpeg_quality)).decode("ascii")
    return f"data:image/webp;base64,{encoded}"


def loss_symbols(text: str):
    """The text escaped, with ``L_contact`` and its like set as the loss's symbol."""
    import markupsafe

    pieces = re.split(r"\bL_([a-z]+)\b", text)
    symbol = markupsafe.Markup("<i>L</i><sub>{}</sub>")
    return markupsafe.Markup("").join(
        symbol.format(piece) if odd % 2 else markupsafe.escape(piece)
        for odd, piece in enumerate(pieces)
    )


def breakable(name: str):
    """A long name, escaped, that a browser may break after its underscores."""
    import markupsafe

    return markupsafe.Markup("_<wbr>").join(name.split("_"))


def curve_points(values: tuple[float, ...]) -> str:
    """Points of an SVG polyline that shows finite values from their least to their largest."""
    series = np.asarray(values, float)
    series = series[np.isfinite(series)]
    if len(series) > 160:
        series = series[np.linspace(0, len(series) - 1, 160).round().astype(int)]
    if len(series) < 2:
        return ""
    width, height = _CURVE_SIZE
    spread = np.ptp(series)
    across = np.linspace(1, width - 1, len(series))
    level = (series - series.min()) / (spread if spread > 0 else 1.0)
    down = height - 2 - level * (height - 4)
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across, down, strict=True))
