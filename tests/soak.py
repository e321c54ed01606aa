"""How much longer `make soak` searches than `make test`: tests multiply their number of inputs by it."""

from __future__ import annotations

import os

FACTOR = int(os.environ.get("TOSVERT_SOAK", "1"))
