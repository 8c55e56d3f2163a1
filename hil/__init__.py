"""hil: record a locked joint, identify the stiffness and damping of its coupling.

    import hil

    run = hil.simulate("run1.h5")                    # or hil.record("stand.toml", profile="multisine")
    result = hil.identify(run)
    print(result, result["Kc"].ci95, result["Kc"].unit)
    result.report("run1.html")

SI everywhere. Arguments have the names, the defaults and the meaning of the command line's options. A function raises
`WrongUse` if the request cannot be carried out, `Untrustworthy` if the data give no result, `drivers.servo.DriverError`
if a drive fails, and `InternalError` if hil itself fails. Each name of this module is loaded at its first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hil.standard_files import open_standard_files

if TYPE_CHECKING:
    from hil.api.analysis import compare, identify, identify_each
    from hil.api.hand import HandResult, load_hand
    from hil.api.hysteresis import HysteresisResult, hysteresis
    from hil.api.planning import DesignResult, design
    from hil.api.recordings import LoadedRecording, load
    from hil.api.results import ComparisonResult, IdentificationResult, NoResult
    from hil.api.runs import Run, record, simulate
    from hil.errors import InternalError, Untrustworthy, WrongUse

__all__ = [
    "ComparisonResult",
    "DesignResult",
    "HandResult",
    "HysteresisResult",
    "IdentificationResult",
    "InternalError",
    "LoadedRecording",
    "NoResult",
    "Run",
    "Untrustworthy",
    "WrongUse",
    "compare",
    "design",
    "hysteresis",
    "identify",
    "identify_each",
    "load",
    "load_hand",
    "record",
    "simulate",
]

_PLACES = {
    "hil.api.analysis": ("compare", "identify", "identify_each"),
    "hil.api.hand": ("HandResult", "load_hand"),
    "hil.api.hysteresis": ("HysteresisResult", "hysteresis"),
    "hil.api.planning": ("DesignResult", "design"),
    "hil.api.recordings": ("LoadedRecording", "load"),
    "hil.api.results": ("ComparisonResult", "IdentificationResult", "NoResult"),
    "hil.api.runs": ("Run", "record", "simulate"),
    "hil.errors": ("InternalError", "Untrustworthy", "WrongUse"),
}


open_standard_files()  # before anything of hil opens a file


def __getattr__(name: str) -> Any:
    """Return a public name from its module. The module is loaded at this moment, so that `import hil` alone is fast."""
    for module, names in _PLACES.items():
        if name in names:
            return getattr(import_module(module), name)
    if name == "__version__":
        return import_module("importlib.metadata").version("hil")
    raise AttributeError(f"module 'hil' has no attribute {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    """Return the public names, for completion in an interactive shell."""
    return __all__
