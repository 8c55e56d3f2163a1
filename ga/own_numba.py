"""Import numba without the settings of a file in the working directory, where somebody else may have put it.

Such a file `.numba_config.yaml` may name the folder from which machine code is loaded, and that code would then run.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def _no_settings_read() -> Iterator[None]:
    """Context manager: inside the `with` block numba cannot import the YAML module, so it reads no settings file. If
    the program imported numba earlier, numba has already read the file.
    """
    before: Any = sys.modules.get("yaml", ...)
    sys.modules["yaml"] = None  # type: ignore[assignment] # an import raises ImportError
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that the file is there and cannot be read
            yield
    finally:
        del sys.modules["yaml"]
        if before is not ...:
            sys.modules["yaml"] = before


if "numba" not in sys.modules:
    with _no_settings_read():
        from numba.core import config
    vars(config)["_config_fname"] = ""  # it looks again whenever it compiles

import numba  # noqa: E402 - what is above comes first
from numba.core import event  # noqa: E402
from numba.core.compiler_lock import global_compiler_lock  # noqa: E402
from numba.core.runtime.nrt import rtsys  # noqa: E402
from numba.extending import overload, register_jitable  # noqa: E402
from numba.misc import appdirs  # noqa: E402

__all__ = ["appdirs", "event", "global_compiler_lock", "numba", "overload", "register_jitable", "rtsys"]
