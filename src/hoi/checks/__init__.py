"""What the configuration points at, checked before hours are spent on it: ``hoi check-data``."""
