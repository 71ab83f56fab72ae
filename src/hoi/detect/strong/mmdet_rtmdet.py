"""RTMDet-Ins by MMDetection: code and weights Apache-2.0."""

from __future__ import annotations

import numpy as np

from hoi.detect.config import ModelFiles
from hoi.detect.labels import COCO80
from hoi.detect.strong.instances import Instance, as_instances
from hoi.errors import AssetError


class RtmDetIns:
    """An instance model; any COCO instance segmentation of MMDetection 3 does.

    `settings` is the model's configuration file, `weights` its checkpoint. Raises AssetError when
    the library is not there.
    """

    def __init__(self, files: ModelFiles, device: str):
        try:
            from mmdet.apis import (  # pyright: ignore[reportMissingImports]
                inference_detector,
                init_detector,
            )
        except ImportError as error:
            raise AssetError(
                f"mmdet cannot be imported ({error}); it needs mmcv (docs/detection.md)"
            ) from error
        self._infer = inference_detector
        self._model = init_detector(files.settings, files.weights, device=device)

    def __call__(self, image: np.ndarray) -> list[Instance]:
        found = self._infer(self._model, np.ascontiguousarray(image[..., ::-1])).pred_instances
        labels: list[str | None] = [COCO80[int(number)] for number in found.labels]
        scores, boxes, masks = (
            getattr(found, key).cpu().numpy() for key in ("scores", "bboxes", "masks")
        )
        return as_instances(labels, scores, boxes, masks)
