"""Object fit: which exemplars, in which pose, explain the object's mask [paper 3.1, 3.5]."""
