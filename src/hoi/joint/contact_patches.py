"""Contacts that come as a probability per body vertex, in place of the interaction map.

Vertices that touch form patches of the body's surface. Each patch looks for the nearest surface of
the object, whichever part that is: the file says where the body touches, not what.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from hoi.errors import FrameFailure
from hoi.joint.contacts import ContactPair

PREFIX = "contact_"


def contact_patches(
    contact: np.ndarray, faces: np.ndarray, threshold: float, most: int
) -> list[tuple[np.ndarray, float]]:
    """Connected patches of touching faces, and the mean probability of each.

    Args:
        contact: (V,) probability of contact.
        faces: (F, 3) of the body; a face touches when all its vertices reach `threshold`.
        most: only so many patches are kept, those with most faces.

    Returns (faces (n, 3), probability) of each patch, the largest first.
    """
    touching = faces[(contact >= threshold)[faces].all(axis=1)]
    if not len(touching):
        return []
    rows, columns = touching[:, [0, 1, 2]].ravel(), touching[:, [1, 2, 0]].ravel()
    links = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(contact),) * 2)
    component = connected_components(links, directed=False)[1][touching[:, 0]]
    found = [touching[component == c] for c in np.unique(component)]
    found.sort(key=len, reverse=True)
    return [(patch, float(contact[np.unique(patch)].mean())) for patch in found[:most]]


def given_patches(
    contact: np.ndarray | None, faces: np.ndarray, num_vertices: int, threshold: float, most: int
) -> dict[str, tuple[np.ndarray, float]]:
    """Name -> patch of a frame's contacts.

    Raises FrameFailure ``no_given_contacts`` or ``contact_size_mismatch``.
    """
    if contact is None:
        raise FrameFailure(
            "no_given_contacts",
            "the method takes contacts per vertex, and no file gives them for this frame; "
            "name it in other_systems.<data set>.contacts",
        )
    if len(contact) != num_vertices:
        raise FrameFailure(
            "contact_size_mismatch",
            f"the contacts are of {len(contact)} vertices, the body model has {num_vertices}; set "
            "assets.body_model to the model that they were made with",
        )
    patches = contact_patches(contact, faces, threshold, most)
    return {f"{PREFIX}{number}": patch for number, patch in enumerate(patches)}


def patch_pairs(
    patches: Mapping[str, tuple[np.ndarray, float]], object_parts: Sequence[str]
) -> list[ContactPair]:
    """Every patch against the whole object, weighted by its probability."""
    return [
        ContactPair(tuple(object_parts), (name,), to_body=False, weight=probability)
        for name, (_, probability) in patches.items()
    ]
