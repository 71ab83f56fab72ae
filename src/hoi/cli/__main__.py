"""``python -m hoi.cli``, the same as ``hoi``."""

import sys

from hoi.cli import main

sys.exit(main())
