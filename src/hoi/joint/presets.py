"""The methods of the tables, as settings that differ from the defaults of JointConfig.

`ours` is the default configuration. `paper` follows Section 3.4 to the letter. The ablations are
`ours` with something left out; the baseline is another list of terms.
"""

from __future__ import annotations

from typing import Any

from hoi.joint.config import JointConfig

_OURS_TERMS = {
    "contact": 1.0,
    "normal": 0.01,
    "penetration": 0.01,
    "object_scale": 0.1,
    "reprojection": 0.0005,
    "ground": 1.0,
}
_PAPER_TERMS = {
    "contact": 1.0,
    "normal": 0.01,
    "penetration": 0.01,
    "object_scale": 0.01,
    "human_scale": 0.01,
    "reprojection": 0.0005,
}
_PHOSA_TERMS = {
    "phosa_silhouette": 10.0,
    "phosa_coarse": 20.0,
    "phosa_parts": 50.0,
    "phosa_object_scale": 100.0,
    "phosa_human_scale": 100.0,
    "phosa_ordinal_depth": 1.0,
}


def _without(terms: dict[str, float], *names: str) -> dict[str, float]:
    return {name: weight for name, weight in terms.items() if name not in names}


#: Keys are method names; values are what JointConfig(**value) needs.
PRESETS: dict[str, dict[str, Any]] = {
    "ours": {"method": "ours", "terms": _OURS_TERMS},
    "paper": {
        "method": "paper",
        "terms": _PAPER_TERMS,
        "contact": "paper",
        "human_scale": "free",
        "sdf_grid": 8,
        "order_weight": 0.0,
        "poses_per_exemplar": 1,
        "max_hypotheses": 5,
        # same loss, same minimum; the published schedule is the one named `paper`
        "fast": {"optimiser": "adam", "iterations": 120, "learning_rate": 1e-2, "decay": True},
        "paper": {"optimiser": "adam", "iterations": 500, "learning_rate": 2e-3},
    },
    "no_action": {"method": "no_action", "terms": _OURS_TERMS, "action": "default"},
    # the floor is a contact too, and known from the same prior: it goes with the others
    "no_contact": {
        "method": "no_contact",
        "terms": _without(_OURS_TERMS, "contact", "normal", "ground"),
    },
    "no_normal": {
        "method": "no_normal",
        "terms": _without(_OURS_TERMS, "normal"),
        "opposing_normals": False,
    },
    "phosa": {
        "method": "phosa",
        "terms": _PHOSA_TERMS,
        "human_scale": "free",
        "order_weight": 0.0,
        "poses_per_exemplar": 1,
        "max_hypotheses": 5,
        "edge_weight": 0.0,
        # the published 400 x 1e-3 is the schedule named `paper`; a quarter of it, four times as far
        "fast": {"optimiser": "adam", "iterations": 100, "learning_rate": 4e-3},
        "paper": {"optimiser": "adam", "iterations": 400, "learning_rate": 1e-3},
    },
}


def preset(name: str) -> JointConfig:
    """The configuration of a method; raises KeyError naming the known ones."""
    if name not in PRESETS:
        raise KeyError(f"unknown method {name!r}; known: {', '.join(PRESETS)}")
    return JointConfig(**PRESETS[name])
