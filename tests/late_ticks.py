"""How late the ticks of a run in real time may be in a test: other work on the machine must not end the run."""

from __future__ import annotations

ALLOWED = {
    "hil.acquisition.guard._LATE_RAMP": 60.0,
    "hil.acquisition.guard._LATE_OFF": 60.0,
    "hil.acquisition.recorder._TOO_LONG": 60_000.0,
    "hil.diagnostics._MOSTLY_LATE": 1.0,
}
"""The constants that end a run for a late tick or find fault with it, and the values that never do."""

ALLOW = f"""\
from importlib import import_module
for name, value in {ALLOWED}.items():
    place, _, constant = name.rpartition(".")
    setattr(import_module(place), constant, value)
"""
"""The same as the beginning of a program."""
