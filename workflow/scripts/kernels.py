"""Compile the numba kernels once, so that no timed or parallel job does."""

from hoi.rendering import warm_up

warm_up()
