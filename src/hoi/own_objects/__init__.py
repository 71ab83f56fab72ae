"""A user's own objects: one command prepares a mesh and what must be known of it; no code."""
