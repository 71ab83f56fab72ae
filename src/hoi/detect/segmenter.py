"""An object's mask from its box by the network of :mod:`hoi.segmenter`, edges by GrabCut."""

from __future__ import annotations

import numpy as np

from hoi.detect.backends import Box, ObjectSegmenter, PersonPose
from hoi.detect.boxes import longer_side, pixel_window, square
from hoi.detect.config import DetectConfig, SegmenterConfig
from hoi.detect.grabcut import GrabCut
from hoi.detect.settling import refined
from hoi.detect.touching import between_hands
from hoi.segmenter.crops import HANDS_SHARE, used_window
from hoi.segmenter.runtime import MaskNetwork


def object_segmenter_of(config: DetectConfig) -> ObjectSegmenter:
    """The segmenter that `config.object_masks` names."""
    colours = GrabCut(config.grabcut, config.blazepose.visible)
    if config.object_masks == "grabcut":
        return colours
    return Segmenter(config.segmenter, MaskNetwork(), colours)


class Segmenter:
    """An :class:`hoi.detect.backends.ObjectSegmenter`.

    Sources it reports: ``segmenter``; ``segmenter_grabcut`` where GrabCut settled the unsure
    pixels; and those of `fallback`, which answers where the network finds next to nothing. A person
    mask that fills the box is not shown to the network: pose models swallow what people hug, wear
    and ride.
    """

    def __init__(self, config: SegmenterConfig, network: MaskNetwork, fallback: ObjectSegmenter):
        self.config = config
        self._network = network
        self._fallback = fallback

    def __call__(
        self, image: np.ndarray, box: Box, pose: PersonPose, seed: int
    ) -> tuple[np.ndarray, str]:
        probability = self.probability(image, box, pose)
        mask = probability > self.config.threshold
        window = pixel_window(box, *image.shape[:2])
        needed = max(self.config.minimum_fill * mask[window].size, 1.0)
        if mask[window].sum() < needed:
            return self._fallback(image, box, pose, seed)
        if self.config.refine:
            settled = refined(image, box, probability, self.config, seed)
            if settled[window].sum() >= needed:
                return settled, "segmenter_grabcut"
        return mask, "segmenter"

    def probability(self, image: np.ndarray, box: Box, pose: PersonPose) -> np.ndarray:
        """(H, W) what the network says of every pixel."""
        window = pixel_window(box, *image.shape[:2])
        share = float((pose.probability[window] > 0.5).mean()) if image[window].size else 0.0
        person = pose.probability
        if share >= self.config.swallowed:
            person = np.zeros_like(person)
        return self._network(image, box, person, self.config.margin)

    def in_use(
        self, image: np.ndarray, person: Box, pose: PersonPose, extent: float | None, held: bool
    ) -> np.ndarray:
        """A :class:`hoi.detect.backends.ThingInUse`: the same network, asked without a box.

        It looks closely at the hands for what is held.
        """
        window = used_window(person, image.shape[:2])
        if held:
            window = square(between_hands(pose), HANDS_SHARE * longer_side(person))
        return self._network.in_use(image, window, pose.probability, extent)
