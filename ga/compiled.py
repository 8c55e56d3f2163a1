"""Compile the hot functions (numba): once, cached in the user's cache folder, without the interpreter lock.

No fast-math: a NaN stays a NaN, and sums keep the order they are written in, so a seed gives the same bits on every
machine. Division follows IEEE 754 and raises nothing.

numba renews a function's machine code when the function's own file changes, but not when a function or a constant of
another file does that was compiled into it. So the cache folder's name holds a hash of the contents of all sources
the machine code can come from: code of a changed, renamed or moved module is never found again.

Several processes share the folder. Each function has a lock in it, so that one process compiles it and the others wait
and load what it made. A function locks those that it calls while it is locked itself; calls have no cycles, so two
processes never wait for each other.

Ctrl-C takes effect between two functions: LLVM calls back into Python, where a KeyboardInterrupt would be lost.

Where no folder can be written, or the disk is full, functions are compiled in memory, and a warning is logged once.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, ParamSpec, TypeVar, cast

from ga import first_run
from ga.collector import uncollected
from ga.own_numba import appdirs, event, global_compiler_lock, numba

if sys.platform != "win32":
    import fcntl

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import IO

P = ParamSpec("P")
R = TypeVar("R")

_OPTIONS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_numba: Any = numba.config  # set from the environment by name, unseen by a type checker
_appdirs: Any = appdirs
_log: Final = logging.getLogger(__name__)
KEPT: Final = 20
"""Folders of machine code kept for each package, the last used first."""
_POLL: Final = 0.05
"""s between two looks at whether another process has finished a function."""


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function` compiled at its first call, as `numba.njit` does."""
    return _compiled(function)


def compiled_no_refcount(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function` compiled without reference counting; it may not allocate.

    Atomic counting of an array's references costs ten times what such a function of an inner loop computes. One whose
    name begins with an underscore can be called from compiled functions only (from Python it would crash): it gets no
    entry from Python, which is half of its compilation.
    """
    return _compiled(function, **_no_refcount(function))


def compiled_inline(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function` compiled as `compiled_no_refcount` does, and always inlined into its caller."""
    return _compiled(function, **_no_refcount(function), forceinline=True)


def compiled_within(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function`, whose lines are compiled as those of the compiled function that calls it.

    For one that is short or called from one or two places: that takes half as long as a function of its own, whose
    machine code nobody runs once it is inlined. From Python it can be called as one of `compiled_no_refcount` can.
    """
    return _compiled(function, **_no_refcount(function), inline="always")


def _no_refcount(function: Callable[P, R]) -> dict[str, bool]:
    return {"_nrt": False, "no_cpython_wrapper": function.__name__.startswith("_")}


def _compiled(function: Callable[P, R], **options: bool | str) -> Callable[P, R]:
    folder = cache_folder(_package(Path(function.__code__.co_filename)))
    every: dict[str, Any] = _OPTIONS | options | {"cache": folder is not None}
    with _numba_set_for(folder):
        try:
            dispatcher: Any = numba.njit(**every)(function)
        except RuntimeError:  # a full disk has no room for a folder of this module's functions
            folder, dispatcher = None, numba.njit(**(every | {"cache": False}))(function)
    if folder is None:
        dispatcher.compile = partial(_compiled_in_memory, dispatcher.compile)
    else:
        lock = folder / f"{function.__module__}.{function.__qualname__}.lock".replace("<", "").replace(">", "")
        dispatcher.compile = partial(_compiled_once, dispatcher.compile, lock)
        dispatcher._cache.save_overload = partial(_kept, dispatcher._cache.save_overload)
    return cast("Callable[P, R]", dispatcher)


def is_compiled(function: Callable[P, R]) -> bool:
    """Return whether machine code of a compiled function is in its cache folder; False where nothing is cached."""
    plain = cast("Any", function).py_func
    folder = cache_folder(_package(Path(plain.__code__.co_filename)))
    return folder is not None and any(folder.rglob(f"*.{plain.__name__}-*.nbi"))


def _compiled_once(compile_or_load: Callable[..., Any], lock: Path, *signature: Any) -> Any:
    """Compile or load a function as numba does, while no other process compiles it."""
    with global_compiler_lock:  # first: a thread that had the file and waited for this one would stop both
        try:
            file = lock.open("ab")
        except OSError:  # the folder was pruned: the function is compiled once more
            return _between_interrupts(compile_or_load, *signature)
        with file, uncollected():  # it takes a sixteenth of the time
            _lock(file)
            return _between_interrupts(compile_or_load, *signature)


def _compiled_in_memory(compile_: Callable[..., Any], *signature: Any) -> Any:
    _say_not_kept()
    return _between_interrupts(compile_, *signature)


def _kept(save: Callable[..., None], *made: Any) -> None:
    """Save machine code, or say that it cannot be kept."""
    try:
        save(*made)
    except OSError:
        _say_not_kept()


@cache
def _say_not_kept() -> None:
    _log.warning(
        "warning: compiled functions cannot be kept, no cache folder has room or may be written; Kc and Bc are the "
        "same, but every run compiles again; make room, or name another folder in NUMBA_CACHE_DIR"
    )


class _Held:
    """A handler of Ctrl-C that notes it."""

    came = False

    def __call__(self, *_: object) -> None:
        self.came = True

    def check(self) -> None:
        """Raise KeyboardInterrupt where it came."""
        if self.came:
            raise KeyboardInterrupt


_held: Final = _Held()


def _between_interrupts(compile_or_load: Callable[..., Any], *signature: Any) -> Any:
    """Compile or load a function, which may compile others that it calls; a Ctrl-C meanwhile is raised afterwards."""
    handler = signal.getsignal(signal.SIGINT)
    outermost = handler is signal.default_int_handler and threading.current_thread() is threading.main_thread()
    if outermost:
        signal.signal(signal.SIGINT, _held)
    try:
        made = compile_or_load(*signature)
        if outermost or handler is _held:
            _held.check()
        return made
    finally:
        if outermost:
            _held.came = False
            signal.signal(signal.SIGINT, handler)


def _lock(file: IO[bytes]) -> None:
    """Lock a file until it is closed; unlocked where the system cannot."""
    if sys.platform == "win32":
        return
    with suppress(OSError):
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                first_run.announce(compiled=0)
                time.sleep(_POLL)
                _held.check()
            else:
                return


class _Announced(event.Listener):
    """Announces each function that is compiled."""

    def on_start(self, _event: Any) -> None:
        first_run.announce(compiled=0)

    def on_end(self, _event: Any) -> None:
        first_run.announce(compiled=1)


event.register("numba:compile", _Announced())  # type: ignore[no-untyped-call]


@contextmanager
def _numba_set_for(folder: Path | None) -> Iterator[None]:
    # numba reads its settings when a function is decorated; the user's own functions keep the user's settings
    names = ("CACHE_DIR", "CACHE_LOCATOR_CLASSES", "DISABLE_JIT")
    before = {name: getattr(_numba, name, None) for name in names}
    ours = {} if folder is None else {"CACHE_DIR": str(folder), "CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
    vars(_numba).update(ours, DISABLE_JIT=0)
    try:
        yield
    finally:
        vars(_numba).update(before)


def _package(source: Path) -> Path:
    """Return the top folder of the package that a source file belongs to, or the file itself if it is in none."""
    top = source
    while (top.parent / "__init__.py").exists():
        top = top.parent
    return top


@cache
def cache_folder(package: Path) -> Path | None:
    """Return the folder for the machine code of a package's (or a single file's) present sources.

    It lies where `NUMBA_CACHE_DIR` says, else in the user's cache folder, else in the package's `__pycache__`: the
    first that can be written. None if none can, or if the sources cannot be read: then nothing is cached. A user
    without a home has no cache folder: that of the working directory would run what somebody else put there.
    """
    try:
        name = f"{package.stem}-{_digest(package, Path(__file__).parent)}"
    except OSError:
        return None
    asked = [Path(_numba.CACHE_DIR)] if _numba.CACHE_DIR else []
    user = Path(_appdirs.user_cache_dir("hil", appauthor=False)) / "machine-code"
    for base in [*asked, *([user] if user.is_absolute() else []), package / "__pycache__"]:
        if _used(base / name):
            _prune(base, package.stem)
            return base / name
    return None


def _digest(*packages: Path) -> str:
    """Return a hash of the names and contents of all sources of packages or single files, and of numba's version."""
    state = hashlib.blake2b(numba.__version__.encode(), digest_size=10)
    for package in packages:
        for source in sorted(package.rglob("*.py")) if package.is_dir() else [package]:
            state.update(f"{source.relative_to(package.parent)}:{source.stat().st_size}:".encode())
            state.update(source.read_bytes())
    return state.hexdigest()


def _used(folder: Path) -> bool:
    """Make a cache folder, or note that it is in use; False if it cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        os.utime(folder)
    except OSError:
        return False
    return True


def _prune(base: Path, package: str) -> None:
    """Delete all but the last used folders of a package's machine code."""
    try:
        by_use = sorted(base.glob(f"{package}-*"), key=lambda folder: folder.stat().st_mtime_ns, reverse=True)
    except OSError:  # another process prunes at the same time
        return
    for folder in by_use[KEPT:]:
        shutil.rmtree(folder, ignore_errors=True)
