"""Data sets: BEHAVE (real or generated, one reader) and folders of photos."""
