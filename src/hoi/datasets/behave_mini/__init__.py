"""`behave_mini`: a generated data set in BEHAVE's own layout, made on the user's machine.

:func:`plan` names its frames at no cost; :func:`hoi.datasets.behave_mini.generate.generate_frames`
writes them; :mod:`hoi.datasets.behave` reads them like the real data set.
"""

from hoi.datasets.behave_mini.config import BehaveMiniConfig
from hoi.datasets.behave_mini.plan import plan

__all__ = ["BehaveMiniConfig", "plan"]
