"""What the table scripts share: evaluations and time sheets of several methods, by protocol."""

import json
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from hoi.artifacts import Evaluation
from hoi.chunks import read_artifacts
from hoi.evaluate.tables import evaluation_frame, under_protocol


class OfMethod(NamedTuple):
    """All frames of one method: evaluations, labels and seconds by frame id."""

    evaluations: list[Evaluation]
    labels: dict[str, dict]
    seconds: dict[str, float]


def read_evaluations(inputs: Any, table: dict) -> list[OfMethod]:
    """The inputs of a table rule (`table_inputs`), method by method."""
    found = []
    for method in table["methods"]:
        seconds: Counter[str] = Counter()
        for path in inputs[f"{method}_seconds"]:
            seconds.update(json.loads(Path(path).read_text()))
        evaluations = [e for index in inputs[method] for e in read_artifacts(Evaluation, index)]
        labels = {key: value | {"method": method} for key, value in table["frames"].items()}
        found.append(OfMethod(evaluations, labels, dict(seconds)))
    return found


def protocols_of(found: list[OfMethod], table: dict) -> dict[str, pd.DataFrame]:
    """Protocol -> one row per frame and method; the main protocol first."""
    frames = {table["align"]: [evaluation_frame(*method) for method in found]}
    for name in table["also"]:
        frames[name] = [
            evaluation_frame(
                under_protocol(method.evaluations, name), method.labels, method.seconds
            )
            for method in found
        ]
    return {name: pd.concat(parts, ignore_index=True) for name, parts in frames.items()}
