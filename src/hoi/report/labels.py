"""How methods are called where people read them."""

METHOD_LABELS = {
    "phosa": "PHOSA",
    "ours": "Ours",
    "paper": "As printed",
    "no_action": "No action",
    "no_contact": "No L_contact",
    "no_normal": "No L_normal",
    "truth": "Truth",
}


def method_label(name: str) -> str:
    """The method's name for people; ``L_…`` in it stands for the symbol of a loss."""
    return METHOD_LABELS.get(name, name)
