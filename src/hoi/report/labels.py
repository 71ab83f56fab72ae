"""How methods are called where people read them."""

METHOD_LABELS = {
    "phosa": "PHOSA",
    "ours": "Ours",
    "paper": "As printed",
    "no_action": "No action",
    "no_contact": "No L_contact",
    "no_normal": "No L_normal",
    "single_action": "Nearest action only",
    "phosa_calib": "PHOSA, true camera",
    "phosa_strong": "PHOSA, true camera, our search",
    "phosa_nocontact": "PHOSA, true camera, no interaction",
    "true_action": "Ours, told the action",
    "true_body": "Ours, told the body",
    "true_choice": "Ours, told the best hypothesis",
    "truth": "Truth",
}


def method_label(name: str) -> str:
    """The method's name for people; ``L_…`` in it stands for the symbol of a loss."""
    return METHOD_LABELS.get(name, name)
