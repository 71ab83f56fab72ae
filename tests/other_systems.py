"""Files as other systems write them, generated: for the tests of the readers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

HEIGHT, WIDTH = 48, 64


def run_length_text(mask: np.ndarray) -> str:
    """COCO's compressed run-length text, number by number as its C code writes it."""
    flat = np.asarray(mask, np.uint8).ravel(order="F")
    runs, value, count = [], 0, 0
    for pixel in flat:
        if pixel != value:
            runs.append(count)
            value, count = pixel, 0
        count += 1
    runs.append(count)
    text = ""
    for i, run in enumerate(runs):
        x = run - (runs[i - 2] if i > 2 else 0)
        more = True
        while more:
            c = x & 0x1F
            x >>= 5
            more = x != -1 if c & 0x10 else x != 0
            text += chr((c | 0x20 if more else c) + 48)
    return text


def runs_of(mask: np.ndarray) -> list[int]:
    """COCO's uncompressed run lengths."""
    flat = np.concatenate([[0], np.asarray(mask, np.int8).ravel(order="F")])
    change = np.flatnonzero(np.diff(flat))
    return np.diff(np.concatenate([[0], change, [mask.size]])).tolist()


def block(x0: int, y0: int, x1: int, y1: int) -> np.ndarray:
    """(H, W) bool rectangle."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[y0:y1, x0:x1] = True
    return mask


def result(mask: np.ndarray, category: int, score: float, image: object = "photo.jpg") -> dict:
    """One entry of a detectron2 ``coco_instances_results.json``."""
    height, width = mask.shape
    return {
        "image_id": image,
        "category_id": category,
        "score": score,
        "bbox": [0, 0, 1, 1],
        "segmentation": {"size": [height, width], "counts": run_length_text(mask)},
    }


def write_json(path: Path, content: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content), encoding="utf-8")
    return path
