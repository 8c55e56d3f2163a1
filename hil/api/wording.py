"""Messages of hil in the words of Python: the option `--model` of a command is the argument `model` here.

An error that neither the request nor the data explains becomes an InternalError.

A remedy is written once, with the options of the command line. The name of an option is a placeholder: a command prints
it, the page of `hil studio` writes its field, and this module writes the argument of `import hil`. Values stay as they
are. An option that prints something is an attribute of the result in Python.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import cache, wraps
from traceback import walk_tb
from typing import Any, TypeVar

from drivers.servo import DriverError
from hil.acquisition.limits import LimitReached
from hil.diagnostics import Diagnostic
from hil.errors import InternalError, Untrustworthy, WrongUse, is_shortage

_ON_THE_COMMAND_LINE = ContextVar("on_the_command_line", default=False)
_OTHER_NAMES = {"from": "`start`", "to": "`end`", "backend": "`stand`"}
_OF_A_RESULT = {"report": "`result.report(path)`", "verbose": "`result.dynamic_stiffness`"}
_WORD = r"[^\s,;`()]*[^\s,;:`()]"
_OPTION = re.compile(
    rf"\bhil [a-z]+(?: (?![a-z]+ ){_WORD})*? --{_WORD}(?: {_WORD})*|(?<![\w-])--([a-z][a-z-]*[a-z])(?!\w)"
)
"""A command of hil with its words, or an option: its name is the group."""
_PACKAGES = frozenset({"hil", "ga", "drivers", "sim_backend"})
_Function = TypeVar("_Function", bound=Callable[..., Any])


@contextmanager
def on_the_command_line() -> Iterator[None]:
    """Leave messages as they are inside the block, because a command prints them."""
    token = _ON_THE_COMMAND_LINE.set(True)
    try:
        yield
    finally:
        _ON_THE_COMMAND_LINE.reset(token)


def is_on_the_command_line() -> bool:
    """Return whether a command called, and not a program."""
    return _ON_THE_COMMAND_LINE.get()


def worded(function: _Function) -> _Function:
    """Return the function with the messages of the errors that it raises in the words of Python.

    An error of hil itself is raised as InternalError; on the command line it is left as it is.
    """

    @wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        try:
            return function(*arguments, **named)
        except Exception as error:
            if len(error.args) == 1 and isinstance(error.args[0], str):
                error.args = (in_python(error.args[0]),)
            if not _ON_THE_COMMAND_LINE.get() and _is_internal(error, (*arguments, *named.values())):
                said = f"{type(error).__name__}: {error}; this is a fault in hil itself: report it with this traceback"
                raise InternalError(said) from error
            raise

    return call  # type: ignore[return-value]


def _is_internal(error: Exception, arguments: tuple[Any, ...]) -> bool:
    """Return whether hil itself is the cause of an error that a function of its API raised.

    It is not for hil's own errors, a shortage of the computer, arguments of a wrong type, and an error of a function
    that the caller gave among the `arguments`.
    """
    expected = (WrongUse, Untrustworthy, DriverError, LimitReached, InternalError)
    if isinstance(error, expected) or is_shortage(error):
        return False
    frames = [frame for frame, _ in walk_tb(error.__traceback__)]
    functions = [
        getattr(one, "__code__", None) or getattr(type(one).__call__, "__code__", None)
        for one in arguments
        if callable(one)
    ]
    modules = [name for frame in frames if (name := str(frame.f_globals.get("__name__"))).split(".")[0] in _PACKAGES]
    return not modules[-1].startswith("hil.api.") and all(frame.f_code not in functions for frame in frames)


def diagnostics_in_python(found: tuple[Diagnostic, ...]) -> tuple[Diagnostic, ...]:
    """Return diagnostics with their messages in the words of Python."""
    return tuple(replace(one, message=in_python(one.message)) for one in found)


def in_python(message: str) -> str:
    """Return a message with the options that it names as arguments; unchanged on the command line.

    An option that is no argument is left as it is, and so is a command of hil with its options.
    """
    if "--" not in message or _ON_THE_COMMAND_LINE.get():
        return message
    return _OPTION.sub(lambda found: _arguments().get(found[1], found[0]), message)


@cache
def _arguments() -> dict[str, str]:
    """Return how Python writes each option that it has: those of the functions that record, identify and measure."""
    from hil import compare, design, hysteresis, identify, record

    functions = (identify, compare, design, hysteresis, record)
    written = dict(_OF_A_RESULT | _OTHER_NAMES)
    for one in (one for each in functions for one in inspect.signature(each).parameters.values()):
        option = one.name.replace("_", "-")
        written[option] = f"`{one.name}=True`" if one.default is False else f"`{one.name}`"
        if one.default is True:
            written[f"no-{option}"] = f"`{one.name}=False`"
    return written
