"""Section 4.2: align the body, carry the object along, measure both by Chamfer distance."""
