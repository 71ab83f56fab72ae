"""The picture of a body's regions."""

import numpy as np
from PIL import Image

from hoi.body import DEFAULT_BODY
from hoi.checks.parts_picture import SHOWN, write_parts_picture


def test_regions_are_drawn_on_both_sides_of_the_body(tmp_path):
    write_parts_picture(DEFAULT_BODY, tmp_path / "parts.png")
    picture = np.asarray(Image.open(tmp_path / "parts.png"))
    front, back = picture[:, :760], picture[:, 760:1520]
    for view in (front, back):
        drawn = (view < 250).any(axis=2)
        assert 0.05 < drawn.mean() < 0.5
        # colour, not the grey of vertices without a region, covers nearly all of the body
        coloured = np.ptp(view.astype(int), axis=2) > 20
        assert coloured[drawn].mean() > 0.9
    mirrored = back[:, ::-1]
    assert (np.abs(front.astype(int) - mirrored) > 30).any(axis=2).sum() > 3000  # belly, back
    legend = (np.ptp(picture[:, 1530:1562].astype(int), axis=2) > 20).any(axis=1)
    assert np.diff(legend.astype(int)).clip(0).sum() == len(SHOWN)
