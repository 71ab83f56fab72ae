"""Shared test settings: one thread per process, reproducible property tests."""

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

from hypothesis import settings  # noqa: E402 - threads are set before anything loads

settings.register_profile("hoi", deadline=None, derandomize=True)
settings.load_profile("hoi")
