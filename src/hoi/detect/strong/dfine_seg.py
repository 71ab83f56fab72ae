"""D-FINE-seg by the package ``dfine_seg``: code and COCO weights Apache-2.0."""

from __future__ import annotations

import numpy as np

from hoi.detect.config import ModelFiles
from hoi.detect.labels import COCO80
from hoi.detect.strong.instances import Instance, as_instances
from hoi.errors import AssetError

#: Every kept instance costs a mask at the photo's size, and the model has 300 candidates.
_FAINTEST = 0.05


class DFineSeg:
    """An instance model; `weights` is a segmentation checkpoint such as ``dfine_seg_l_coco.pt``.

    Raises AssetError when the library is not there or the file is no such checkpoint.
    """

    def __init__(self, files: ModelFiles, device: str):
        try:
            from dfine_seg import load_model  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise AssetError(
                f"dfine_seg cannot be imported ({error}); pip install dfine-seg (docs/detection.md)"
            ) from error
        try:
            self._model = load_model(
                files.weights, task="segment", conf_thresh=_FAINTEST, device=device
            )
        except Exception as error:  # whatever a damaged file makes of it
            raise AssetError(f"{files.weights}: not D-FINE-seg weights: {error}") from error
        # a checkpoint trained on other classes brings their names
        self._names = self._model.names or dict(enumerate(COCO80))

    def __call__(self, image: np.ndarray) -> list[Instance]:
        (found,) = self._model(np.ascontiguousarray(image[..., ::-1]))
        if not len(found["scores"]):
            return []  # without masks, too
        labels = [self._names.get(int(number)) for number in found["labels"]]
        scores, boxes, masks = (found[key].cpu().numpy() for key in ("scores", "boxes", "masks"))
        return as_instances(labels, scores, boxes, masks)
