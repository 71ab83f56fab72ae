"""The prior stage: size and contacts of one frame, looked up and never invented [paper 3.3]."""

from __future__ import annotations

from pathlib import Path

from hoi.artifacts import Action, Contact, Frame, Interaction, Prior
from hoi.errors import FrameFailure
from hoi.priors.config import PriorsConfig
from hoi.priors.mapping import expand_region
from hoi.priors.tables import ContactAnswer, PriorTables, load_tables


class PriorStage:
    """Looks up recorded answers for a frame's object and action.

    Args:
        config: settings of the stage.
        priors_dir: folder with sizes.csv, contacts.csv and actions.csv; None for the package's.
    """

    def __init__(self, config: PriorsConfig, priors_dir: Path | str | None = None):
        self._config = config
        folder = None if priors_dir is None else Path(priors_dir)
        self._tables = load_tables(folder, paper_only=config.answers == "paper")

    def __call__(self, frame: Frame, action: Action, seed: int = 0) -> Prior:
        """The prior of the retrieved action, and of the category's default action.

        Raises FrameFailure: ``no_size_prior`` for an object without a size, ``no_contact_prior``
        for an action without contacts.
        """
        size = self._tables.sizes.get(frame.category)
        if size is None:
            raise FrameFailure(
                "no_size_prior",
                f"no recorded size of a {frame.category!r}; known: "
                + ", ".join(sorted(self._tables.sizes)),
            )
        assert action.action is not None
        return Prior(
            frame_id=frame.frame_id,
            category=frame.category,
            size_m=size.size_m,
            size_axis=size.axis if self._config.size_axis == "reviewed" else "longest",
            size_source=size.source,
            retrieved=self.interaction(frame.category, action.action),
            default=self.interaction(frame.category, action.default_action or action.action),
        )

    def interaction(self, category: str, action: str) -> Interaction:
        """The interaction map's entry for one action with one object."""
        return lookup_interaction(self._tables, category, action, self._config.min_probability)


def lookup_interaction(
    tables: PriorTables, category: str, action: str, min_probability: float = 0.0
) -> Interaction:
    """Contacts of one action with one object; raises FrameFailure when none is recorded."""
    answers = tables.contacts.get((category, action), ())
    if not answers:
        known = sorted(name for noun, name in tables.contacts if noun == category)
        raise FrameFailure(
            "no_contact_prior",
            f"no recorded contacts of {action!r} with a {category}; known: "
            + (", ".join(known) or "none"),
        )
    contacts: list[Contact] = []
    unmapped: list[str] = []
    for answer in answers:
        found = [c for c in _contacts(answer) if c.probability >= min_probability]
        contacts.extend(found)
        if not _contacts(answer):
            unmapped.append(_unmapped(answer))
    if not contacts:
        raise FrameFailure(
            "no_contact_prior",
            f"no contact of {action!r} with a {category} names a part that can be used"
            + (f": {'; '.join(unmapped)}" if unmapped else ""),
        )
    return Interaction(
        action=action,
        contacts=contacts,
        unmapped=unmapped,
        stands_on_floor=tables.stands_on_floor.get((category, action), False),
        feet_on_floor=tables.feet_on_floor.get((category, action), True),
        source="; ".join(dict.fromkeys(answer.source for answer in answers)),
    )


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
