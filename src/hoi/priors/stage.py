"""The prior stage: size and contacts of one frame, looked up and never invented [paper 3.3]."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from hoi.artifacts import (
    Action,
    Arrangement,
    Contact,
    ContactSet,
    Extent,
    Extents,
    Frame,
    Interaction,
    Prior,
)
from hoi.errors import FrameFailure
from hoi.priors.config import LookupConfig
from hoi.priors.corruption import corrupted
from hoi.priors.mapping import expand_region
from hoi.priors.tables import ContactAnswer, ExtentsAnswer, PriorTables, load_tables


class PriorStage:
    """Looks up recorded answers for a frame's object and action.

    Args:
        config: settings of the stage.
        priors_dir: folder with sizes.csv, contacts.csv and actions.csv; None for the package's.
    """

    def __init__(self, config: LookupConfig, priors_dir: Path | str | None = None):
        self._config = config
        folder = None if priors_dir is None else Path(priors_dir)
        self._tables = load_tables(folder, paper_only=config.answers == "paper")

    def __call__(self, frame: Frame, action: Action, seed: int = 0) -> Prior:
        """The prior of the retrieved action, and of the category's default action.

        Raises FrameFailure: ``no_size_prior`` for an object without a size, ``no_contact_prior``
        for an action without contacts.
        """
        config = self._config
        size = self._tables.sizes.get(frame.category)
        if size is None:
            raise FrameFailure(
                "no_size_prior",
                f"no recorded size of a {frame.category!r}; known: "
                + ", ".join(sorted(self._tables.sizes)),
            )
        assert action.action is not None
        # only a study of wrong answers draws lots
        tables = corrupted(self._tables, config, seed) if config.studies_answers else self._tables

        def interaction(name: str) -> Interaction:
            return self._look_up(tables, frame.category, name)

        return Prior(
            frame_id=frame.frame_id,
            category=frame.category,
            size_m=size.size_m,
            size_axis=size.axis if config.size_axis == "reviewed" else "longest",
            size_source=size.source,
            extents=_extents(tables.extents.get(frame.category)),
            retrieved=interaction(action.action),
            default=interaction(action.default_action or action.action),
            true=_true(interaction, frame.action),
            hypotheses=self._hypotheses(interaction, action),
        )

    def _hypotheses(
        self, interaction_of: Callable[[str], Interaction], action: Action
    ) -> list[Interaction]:
        """Likely interactions, most probable first; actions with the same contacts are one.

        Actions without recorded contacts are left out; the retrieved one is always in.
        """
        assert action.action is not None
        likely = [(action.action, action.probability or 1.0)]
        likely += [(other.action, other.probability) for other in action.runners_up]
        merged: dict[tuple, Interaction] = {}
        for name, probability in likely:
            try:
                interaction = interaction_of(name)
            except FrameFailure:
                continue
            same = merged.get(_what_touches(interaction))
            if same is not None:
                interaction, probability = same, probability + same.probability
            merged[_what_touches(interaction)] = interaction.model_copy(
                update={"probability": probability}
            )
        ranked = sorted(merged.values(), key=lambda interaction: -interaction.probability)
        return [
            interaction
            for interaction in ranked[: self._config.max_hypotheses]
            if interaction.probability >= self._config.min_hypothesis
            or interaction.action == action.action
        ]

    def interaction(self, category: str, action: str) -> Interaction:
        """The interaction map's entry for one action with one object."""
        return self._look_up(self._tables, category, action)

    def _look_up(self, tables: PriorTables, category: str, action: str) -> Interaction:
        config = self._config
        most = config.max_alternatives if config.alternatives != "none" else 0
        return lookup_interaction(tables, category, action, config.min_probability, most)


def lookup_interaction(
    tables: PriorTables,
    category: str,
    action: str,
    min_probability: float = 0.0,
    max_alternatives: int = 0,
) -> Interaction:
    """Contacts of one action with one object; raises FrameFailure when none is recorded.

    An action of which the tables say that nothing touches (more often than not) has no contacts.
    """
    key = category, action
    answers, arrangement = tables.contacts.get(key, ()), tables.arrangements.get(key)
    no_contact = arrangement.no_contact if arrangement else 0.0
    if not answers and no_contact < 0.5:
        known = sorted(name for noun, name in tables.contacts if noun == category)
        raise FrameFailure(
            "no_contact_prior",
            f"no recorded contacts of {action!r} with a {category}; known: "
            + (", ".join(known) or "none"),
        )
    contacts = usable_contacts(answers, min_probability)
    unmapped = [_unmapped(answer) for answer in answers if not _contacts(answer)]
    if not contacts and no_contact < 0.5:
        raise FrameFailure(
            "no_contact_prior",
            f"no contact of {action!r} with a {category} names a part that can be used"
            + (f": {'; '.join(unmapped)}" if unmapped else ""),
        )
    return Interaction(
        action=action,
        contacts=contacts,
        alternatives=_alternatives(tables, key, max_alternatives),
        no_contact=no_contact,
        arrangement=Arrangement(
            relation=arrangement.relation,  # type: ignore[arg-type]  # checked when it is read
            facing=arrangement.facing,  # type: ignore[arg-type]
            source=arrangement.source,
        )
        if arrangement
        else None,
        unmapped=unmapped,
        stands_on_floor=tables.stands_on_floor.get(key, False),
        feet_on_floor=tables.feet_on_floor.get(key, True),
        source="; ".join(dict.fromkeys(answer.source for answer in answers)),
    )


def usable_contacts(
    answers: Iterable[ContactAnswer], min_probability: float = 0.0
) -> list[Contact]:
    """Contacts of the answers that have labels and are probable enough."""
    return [c for a in answers for c in _contacts(a) if c.probability >= min_probability]


def _alternatives(tables: PriorTables, key: tuple[str, str], most: int) -> list[ContactSet]:
    return [
        ContactSet(
            name=answer.name,
            contacts=usable_contacts(answer.pairs),
            probability=answer.probability,
            source=answer.source,
        )
        for answer in tables.alternatives.get(key, ())[:most]
    ]


def _extents(answer: ExtentsAnswer | None) -> Extents | None:
    if answer is None:
        return None
    ranges = {
        axis: Extent(low=low, typical=typical, high=high)
        for axis in ("height", "width", "depth")
        for low, typical, high in [getattr(answer, axis) or (0.0, 0.0, 0.0)]
        if typical > 0
    }
    return Extents(**ranges, source=answer.source)


def _true(interaction_of: Callable[[str], Interaction], action: str) -> Interaction | None:
    """What the data set says the person does; None where it does not say or nobody answered."""
    try:
        return interaction_of(action) if action else None
    except FrameFailure:
        return None


def _what_touches(interaction: Interaction) -> tuple:
    """Equal for two actions that the joint stage cannot tell apart."""

    def pairs(contacts: Iterable[Contact]) -> tuple:
        return tuple(sorted((c.object_part, c.body_part, c.side, c.probability) for c in contacts))

    others = tuple(sorted(pairs(other.contacts) for other in interaction.alternatives))
    floor = interaction.stands_on_floor, interaction.feet_on_floor
    return pairs(interaction.contacts), others, floor


def _contacts(answer: ContactAnswer) -> list[Contact]:
    """One contact per body region that the answer names; none when a part has no label."""
    regions = expand_region(answer.body_region, answer.side) if answer.object_part else ()
    return [
        Contact(
            object_part=answer.object_part,
            body_part=region,
            side=answer.side,  # type: ignore[arg-type]  # checked when the table is read
            probability=answer.probability,
            source=answer.source,
        )
        for region in regions
    ]


def _unmapped(answer: ContactAnswer) -> str:
    reason = answer.note or "no label for it"
    return f"{answer.answer_object_part}/{answer.answer_body_part}: {reason}"
