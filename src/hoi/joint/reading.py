"""What a method reads of a frame's prior. Light: imported before anything is optimised."""

from __future__ import annotations

from collections.abc import Sequence

from hoi.artifacts import Contact, ContactSet, Interaction, Prior
from hoi.errors import FrameFailure
from hoi.joint.config import JointConfig


def interactions(prior: Prior, action: str) -> Sequence[Interaction]:
    """The interactions to try. Raises FrameFailure `no_prior` when the prior holds none."""
    if action == "hypotheses" and prior.hypotheses:
        return prior.hypotheses
    if action == "true" and prior.true is not None:
        return [prior.true]
    interaction = prior.default if action == "default" else prior.retrieved
    if interaction is None:
        raise FrameFailure("no_prior", f"the prior holds no {action} interaction")
    return [interaction]


def what_is_read(prior: Prior, config: JointConfig) -> Prior:
    """The prior without what the method never looks at.

    A stage that is given this has the same result whatever is said of other actions, in other
    words, or by somebody else: nothing has to be computed anew when only that changes.
    """
    tried = [_read_of(interaction, config) for interaction in interactions(prior, config.action)]
    return Prior(
        frame_id=prior.frame_id,
        category=prior.category,
        size_m=prior.size_m,
        size_axis=prior.size_axis,
        extents=prior.extents if config.size == "range" else None,
        # the interactions to try of this prior are those of the whole one
        retrieved=tried[0],
        default=tried[0],
        true=tried[0] if config.action == "true" else None,
        hypotheses=tried if config.action == "hypotheses" else [],
    )


def _read_of(interaction: Interaction, config: JointConfig) -> Interaction:
    sets = interaction.alternatives if config.contact_sets == "alternatives" else []
    return Interaction(
        action=interaction.action,
        contacts=_unsigned(interaction.contacts),
        alternatives=[
            ContactSet(
                name=each.name, contacts=_unsigned(each.contacts), probability=each.probability
            )
            for each in sets
        ],
        no_contact=interaction.no_contact if config.no_contact == "weigh" else 0.0,
        arrangement=interaction.arrangement if config.arrangement_weight > 0 else None,
        stands_on_floor=interaction.stands_on_floor,
        feet_on_floor=interaction.feet_on_floor,
        probability=interaction.probability,
    )


def _unsigned(contacts: Sequence[Contact]) -> list[Contact]:
    return [contact.model_copy(update={"source": ""}) for contact in contacts]
