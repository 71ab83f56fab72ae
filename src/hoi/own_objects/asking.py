"""What a language model says of an own object: the paper's prompts, asked or replayed [3.3]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hoi.errors import ConfigError
from hoi.own_objects.description import OwnContact
from hoi.own_objects.knowledge import body_region, object_part
from hoi.priors.client import LanguageModel
from hoi.priors.config import LanguageModelConfig
from hoi.priors.interview import ask_contacts, ask_size


class Said(NamedTuple):
    """Contacts that name parts of the mesh and of the body, and the answers that do not."""

    contacts: tuple[OwnContact, ...]
    unmapped: tuple[str, ...]


def model_of(config: LanguageModelConfig) -> LanguageModel:
    """The configured model; raises ConfigError when none is named."""
    if not config.model:
        raise ConfigError(
            "--ask: no language model is configured; name one under priors.llm (model, base_url, "
            "and mode: record to ask for what is not recorded), or give --contact"
        )
    return LanguageModel(config, config.recordings)


def said_size(model: LanguageModel, category: str) -> float:
    """Metres; raises ConfigError when no answer can be read."""
    try:
        return ask_size(model, category.replace("_", " "))
    except ValueError as error:
        raise ConfigError(f"{error}; give --size") from error


def said_contacts(model: LanguageModel, category: str, action: str, parts: Sequence[str]) -> Said:
    """Contacts of an action, each with the share of the model's answers that name it.

    Raises ConfigError when no answer can be read or none names a part of the mesh.
    """
    source = f"answer of {model.config.model}"
    try:
        named = ask_contacts(model, category.replace("_", " "), action)
    except ValueError as error:
        raise ConfigError(f"{error}; give --contact") from error
    contacts, unmapped = [], []
    for (thing, body), share in named.items():
        try:
            region, side = body_region(body)
            part = object_part(thing, parts)
        except ConfigError as error:
            unmapped.append(f"{thing}/{body}: {error}")
            continue
        # "hands" of an answer does not say whether both touch; a named side does
        side = side if side in ("left", "right") else ""
        contacts.append(
            OwnContact.model_validate(
                {
                    "object": part,
                    "body": region,
                    "side": side,
                    "probability": round(share, 4),
                    "source": source,
                }
            )
        )
    if not contacts:
        raise ConfigError(
            f"{model.config.model} names no part of this mesh for {action!r}: "
            + ("; ".join(unmapped) or "nothing touches")
            + ". Name the mesh's parts with --part GROUP=PART, or give --contact"
        )
    return Said(tuple(contacts), tuple(unmapped))
