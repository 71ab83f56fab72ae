"""torchvision's Mask R-CNN (maskrcnn_resnet50_fpn_v2, COCO): code BSD-3-Clause."""

from __future__ import annotations

import numpy as np

from hoi.detect.config import ModelFiles
from hoi.detect.labels import COCO80
from hoi.detect.strong.instances import Instance, as_instances
from hoi.detect.strong.selection import weights_of
from hoi.errors import AssetError

#: Numbers below 91 that COCO's annotations skip.
_UNUSED = (12, 26, 29, 30, 45, 66, 68, 69, 71, 83)
#: COCO's own number of a class -> its name: 1 is person, 62 chair.
COCO91 = dict(zip((n for n in range(1, 91) if n not in _UNUSED), COCO80, strict=True))


class TorchvisionMaskRcnn:
    """An instance model. Raises AssetError when the library or its weights are not there."""

    def __init__(self, files: ModelFiles, device: str):
        try:
            import torch
            from torchvision.models.detection import (  # pyright: ignore[reportMissingImports]
                maskrcnn_resnet50_fpn_v2,
            )
        except ImportError as error:
            raise AssetError(
                f"torchvision cannot be imported ({error}); install the release that fits your "
                "torch (docs/detection.md)"
            ) from error
        path = weights_of("torchvision", files)
        assert path is not None
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:  # whatever a damaged file makes of it
            raise AssetError(f"{path}: not readable as torchvision weights: {error}") from error
        self._torch, self._device = torch, device
        self._model = maskrcnn_resnet50_fpn_v2(weights=None, weights_backbone=None)
        self._model.load_state_dict(state)
        self._model.eval().to(device)

    def __call__(self, image: np.ndarray) -> list[Instance]:
        pixels = self._torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1)
        with self._torch.inference_mode():
            (found,) = self._model([pixels.to(self._device).float() / 255])
        labels = [COCO91.get(int(number)) for number in found["labels"]]
        arrays = (found[key].cpu().numpy() for key in ("scores", "boxes", "masks"))
        scores, boxes, masks = arrays
        return as_instances(labels, scores, boxes, masks[:, 0])
