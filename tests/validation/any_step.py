"""Steps beyond the limit that `simulate` keeps, to see what they do."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import Any


@contextmanager
def any_step():
    """Within, `simulate` takes steps of any size."""
    module: Any = sys.modules["jaxsph.simulate"]
    kept = module.largest_stable
    module.largest_stable = lambda *arguments: float("inf")
    try:
        yield
    finally:
        module.largest_stable = kept
