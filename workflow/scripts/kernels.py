"""Compile the numba kernels once, so that no timed or parallel job does."""

import hoi.joint.warmup
import hoi.rendering.warmup

hoi.rendering.warmup.warm_up()
hoi.joint.warmup.warm_up()
