"""The detect stage: a person, an object, their masks, the person's keypoints (section 3.1)."""

from hoi.detect.config import DetectConfig

__all__ = ["DetectConfig"]
