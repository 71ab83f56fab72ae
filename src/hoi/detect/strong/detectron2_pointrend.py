"""PointRend by detectron2, the paper's detector: code Apache-2.0, weights CC BY-SA 3.0."""

from __future__ import annotations

import numpy as np

from hoi.detect.config import ModelFiles
from hoi.detect.labels import COCO80
from hoi.detect.strong.instances import Instance, as_instances
from hoi.errors import AssetError


class Detectron2PointRend:
    """An instance model. Its `settings` file is one of PointRend's ``InstanceSegmentation``
    configurations, its `weights` the ``.pkl`` of the same name: a pickle, so only from a source
    that you trust. Raises AssetError when the library is not there.
    """

    def __init__(self, files: ModelFiles, device: str):
        try:
            from detectron2.config import get_cfg  # pyright: ignore[reportMissingImports]
            from detectron2.engine import (  # pyright: ignore[reportMissingImports]
                DefaultPredictor,
            )
            from detectron2.projects import point_rend  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise AssetError(
                f"detectron2 with its project PointRend cannot be imported ({error}); it is built "
                "from source (docs/detection.md)"
            ) from error
        settings = get_cfg()
        point_rend.add_pointrend_config(settings)
        settings.merge_from_file(files.settings)
        settings.MODEL.WEIGHTS = files.weights
        settings.MODEL.DEVICE = device
        # every threshold is this package's own
        settings.MODEL.ROI_HEADS.SCORE_THRESH_TEST = 0.0
        self._predict = DefaultPredictor(settings)

    def __call__(self, image: np.ndarray) -> list[Instance]:
        found = self._predict(np.ascontiguousarray(image[..., ::-1]))["instances"].to("cpu")
        labels: list[str | None] = [COCO80[int(number)] for number in found.pred_classes]
        return as_instances(
            labels,
            found.scores.numpy(),
            found.pred_boxes.tensor.numpy(),
            found.pred_masks.numpy(),
        )
