"""Switch off Python's garbage collector, which otherwise examines all objects of all imported modules again and
again.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def uncollected() -> Iterator[None]:
    """Switch off the garbage collector in a `with` block: for code in which collecting takes much time and frees little
    memory, or would delay a control loop.
    """
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()
