"""Compile the hot functions (numba): once, cached in the user's cache folder, and without the interpreter lock.

No fast-math: a NaN stays a NaN, and sums are computed in the order in which they are written, so a seed gives the same
bits on every machine. Division follows IEEE 754 and raises nothing.

numba recompiles a function when its own file changes, but not when a function or a constant of another file changes
that was compiled into it. Therefore the name of the cache folder contains a hash of all sources that the machine code
can come from: machine code of a changed, renamed or moved module is never found again.

Several processes share the folder. Each function has a lock file in the folder, so that one process compiles the
function and the others wait and load the result. While a function is locked, it locks the functions that it calls.
Calls have no cycles, so two processes never wait for each other.

Ctrl-C takes effect between two functions: LLVM calls back into Python, where a KeyboardInterrupt would be lost.

Machine code is loaded only from a folder that nobody else can write. If others can write the folder, no folder can be
written, or the disk is full, functions are compiled in memory, and a warning is logged once. A damaged file of the
cache is replaced.
"""

from __future__ import annotations

import logging
import signal
import sys
import threading
import time
from contextlib import contextmanager, suppress
from functools import cache, partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Generic, ParamSpec, TypeVar, cast

from ga import first_run
from ga.collector import uncollected
from ga.machine_code import cache_folder, package_of, refused
from ga.own_numba import event, global_compiler_lock, numba, overload, register_jitable, rtsys

if sys.platform != "win32":
    import fcntl

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import IO

P = ParamSpec("P")
R = TypeVar("R")

_OPTIONS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_CALLED: Final[dict[str, Any]] = {"error_model": "numpy", "_nrt": False}
_numba: Any = numba.config  # set from the environment by name, unseen by a type checker
_LEAN: Final = ((0, 61), (0, 68))
"""The first and the last version of numba whose machine code was tested without numba's declarations."""
_log: Final = logging.getLogger(__name__)
_POLL: Final = 0.05
"""The time, s, between two checks whether another process has finished a function."""


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function`, which numba compiles at its first call (`numba.njit`)."""
    return _compiled(function)


def compiled_no_refcount(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function`, compiled without reference counting; it must not allocate memory.

    Atomic counting of an array's references takes ten times as long as the computation in such a function of an inner
    loop. A function whose name begins with an underscore can be called from compiled functions only (a call from Python
    would crash): no entry from Python is compiled for it, which saves half of the compilation.
    """
    return _compiled(function, **_no_refcount(function))


def compiled_inline(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function`, compiled without reference counting and always inlined into its caller."""
    return _compiled(function, **_no_refcount(function), forceinline=True)


def compiled_within(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function`, whose lines are compiled as a part of the compiled function that calls it.

    This is for a function that is short, or called from one or two places: it takes half as long as compiling a
    separate function, whose machine code is not used once it is inlined. A function with many branches is compiled
    faster as a separate function: numba copies each of its blocks, with all variables, twice. A function whose name
    begins with an underscore must not be called from Python.
    """
    return _compiled(function, **_no_refcount(function), inline="always")


def compiled_too(function: Callable[P, R]) -> Callable[P, R]:
    """Return `function` itself, which can be called from Python, and from compiled functions."""
    register_jitable(**_CALLED)(function)
    return function


def compiled_as(function: Callable[P, R]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate what takes the place of the Python function `function` where a compiled function calls it.

    Both must return the same to the last bit: one is written for NumPy, the other for the compiler.
    """

    def taken(other: Callable[P, R]) -> Callable[P, R]:
        chosen = lambda *_: other  # noqa: E731 - numba asks it for what it compiles
        vars(chosen)["__signature__"] = signature(function)  # numba compares it
        overload(function, jit_options=_CALLED)(chosen)  # type: ignore[arg-type]  # options that numba does not list
        return other

    return taken


class compiled_when_worth(Generic[P, R]):  # noqa: N801 - used as a decorator
    """Decorate a Python function that is also compiled, without reference counting, once that is worth its time.

    Machine code that an earlier process kept is used at once. Otherwise Python runs it until it has taken as long as
    compiling would, because a first result must not wait for the compiler. Both return the same to the last bit. The
    types of the arguments must always be the same.
    """

    worth: ClassVar[float] = 2.0
    """The processor time, s, that a function takes in Python before it is compiled, about what compiling takes."""

    def __init__(self, function: Callable[P, R]) -> None:
        self._in_python, self._in_machine_code = function, _compiled(function, _nrt=False)
        self._spent = self.worth if self._is_kept() else 0.0

    def _is_kept(self) -> bool:
        folder = cast("Any", self._in_machine_code).stats.cache_path
        name = f"{self._in_python.__module__.rpartition('.')[2]}.{self._in_python.__qualname__}-*.nbc"
        return folder is not None and any(Path(folder).glob(name))

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call the function."""
        if self._spent >= self.worth:
            return self._in_machine_code(*args, **kwargs)
        began = time.thread_time()
        try:
            return self._in_python(*args, **kwargs)
        finally:
            self._spent += time.thread_time() - began


def _no_refcount(function: Callable[P, R]) -> dict[str, bool]:
    return {"_nrt": False, "no_cpython_wrapper": function.__name__.startswith("_")}


def _compiled(function: Callable[P, R], **options: bool | str) -> Callable[P, R]:
    folder = cache_folder(package_of(Path(function.__code__.co_filename)))
    every: dict[str, Any] = _OPTIONS | options | {"cache": folder is not None}
    with _numba_set_for(folder):
        try:
            dispatcher: Any = numba.njit(**every)(function)
        except RuntimeError:  # a full disk has no room for a folder of this module's functions
            folder, dispatcher = None, numba.njit(**(every | {"cache": False}))(function)
    # no other package adds to what is compiled here, and a search for one that does reads a file of every package
    dispatcher._compilation_chain_init_hook = _nothing
    if folder is None:
        dispatcher.compile = partial(_compiled_in_memory, dispatcher.compile)
    else:
        lock = folder / f"{function.__module__}.{function.__qualname__}.lock".replace("<", "").replace(">", "")
        dispatcher.compile = partial(_compiled_once, dispatcher.compile, lock)
        dispatcher._cache.load_overload = partial(_loaded, dispatcher._cache, dispatcher._cache.load_overload)
        dispatcher._cache.save_overload = partial(_kept, dispatcher._cache.save_overload)
    return cast("Callable[P, R]", dispatcher)


def _nothing() -> None:
    """Stand in for what numba would do and that needs not be done here."""


def _compiled_once(compile_or_load: Callable[..., Any], lock: Path, *signature: Any) -> Any:
    """Compile or load a function as numba does, while no other process compiles the same function."""
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


def _loaded(stored: Any, load: Callable[..., Any], types: Any, target: Any) -> Any:
    """Load machine code; None if there is none. If a file is damaged, clear the index `stored`, so that it is compiled
    again.

    types: of the arguments. target: numba's declarations of all that it can compile.
    """
    try:
        with _not_declared_again(target):
            return load(types, target)
    except Exception:  # noqa: BLE001 - bytes of a damaged file can raise anything
        with suppress(OSError):
            stored.flush()
        return None


@contextmanager
def _not_declared_again(target: Any) -> Iterator[None]:
    """Context manager: inside the `with` block numba does not import what only a compilation needs.

    Machine code calls numba's run-time library and the C library only; the import would take a quarter of a second, and
    numba makes up for it where it compiles. Other versions of numba than the tested ones load as they are made to.
    """
    if not _LEAN[0] <= numba.version_info.short <= _LEAN[1]:
        yield
        return
    rtsys.initialize(target)
    target.refresh = _nothing
    try:
        yield
    finally:
        del target.refresh


def _kept(save: Callable[..., None], *made: Any) -> None:
    """Save machine code in the cache, or log a warning that it cannot be saved."""
    try:
        save(*made)
    except Exception:  # noqa: BLE001 - a full disk, or a damaged index that could not be cleared
        _say_not_kept()


@cache
def _say_not_kept() -> None:
    why, remedy = "no cache folder has room or may be written", "make room, or name another folder"
    if refused:
        why = f"others can change {refused[0]} and would run code of theirs here"
        remedy = "name a folder that only you can write"
    _log.warning(
        "warning: compiled functions cannot be kept, %s; Kc and Bc are the same, but every run compiles again; %s in "
        "NUMBA_CACHE_DIR",
        why,
        remedy,
    )


class _Held:
    """A handler of Ctrl-C that only records that Ctrl-C was pressed."""

    came = False

    def __call__(self, *_: object) -> None:
        self.came = True

    def check(self) -> None:
        """Raise KeyboardInterrupt if Ctrl-C was pressed."""
        if self.came:
            raise KeyboardInterrupt


_held: Final = _Held()


def _between_interrupts(compile_or_load: Callable[..., Any], *signature: Any) -> Any:
    """Compile or load a function, and the functions that it calls. A Ctrl-C during this time is raised afterwards."""
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
    """Lock a file until the file is closed. Without support by the system the file stays unlocked."""
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
    """A listener of numba's events that announces each compilation of a function through `ga.first_run`."""

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
