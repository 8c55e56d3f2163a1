"""Messages of hil in the words of Python: the option `--model linear` of a command is the argument model="linear" here.

An error that neither the request nor the data explains becomes an InternalError.

A remedy is written once, with the options of the command line. In Python the same remedy is read as the options that it
names, and each option that a function of `import hil` has as an argument is written as that argument: with its value as
model="linear", without one as `model`. An option that prints something is an attribute of the result in Python.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import cache, wraps
from traceback import walk_tb
from types import MappingProxyType
from typing import Any, TypeVar

from drivers.servo import DriverError
from hil.acquisition.limits import LimitReached
from hil.diagnostics import Diagnostic
from hil.errors import InternalError, Untrustworthy, WrongUse, is_shortage

_ON_THE_COMMAND_LINE = ContextVar("on_the_command_line", default=False)
_OTHER_NAMES = {"from": "start", "to": "end", "backend": "stand"}
_OF_A_RESULT = {"report": "`result.report(path)`", "verbose": "`result.dynamic_stiffness`"}
_PACKAGES = frozenset({"hil", "ga", "drivers", "sim_backend"})
_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"
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
                error.args = (in_python(error.args[0], inspect.signature(function).parameters),)
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


def in_python(message: str, own: Mapping[str, inspect.Parameter] = MappingProxyType({})) -> str:
    """Return a message with the options that it names as arguments; unchanged on the command line.

    own: further parameters of the called function, besides those of the functions that record and identify. An option
    that is no argument, and a command with other words than such options, are left as they are.
    """
    if "--" not in message or _ON_THE_COMMAND_LINE.get():
        return message
    known = {**_arguments(), **own}
    option, commands = _grammar()

    def written(found: re.Match[str]) -> str:
        if found["command"] is None:
            given = [_argument(one, known, "`{}`") for one in option.finditer(found["alone"])]
            return found[0] if None in given else ", ".join(map(str, given))
        given = [_argument(one, known, "{}=...") for one in option.finditer(found["options"])]
        as_call = not found["words"] and None not in given and found["command"] in ("identify", "compare", "record")
        return f"hil.{found['command']}(..., {', '.join(map(str, given))})" if as_call else found[0]

    return commands.sub(written, message)


def _argument(found: re.Match[str], known: Mapping[str, inspect.Parameter], alone: str) -> str | None:
    """Return an option, and its value if the message states one, as an argument; None if it is none of `known`.

    alone: how an argument without a value is written.
    """
    option, value = found[1], found[2]
    name = option.replace("-", "_")
    name = _OTHER_NAMES.get(name, name)
    if name.startswith("no_") and name[3:] in known and known[name[3:]].default is True:
        return f"{name[3:]}=False"
    if name not in known:
        return _OF_A_RESULT.get(name)
    if known[name].default is False:
        return f"{name}=True"
    is_pair = "tuple[float, float]" in str(known[name].annotation)
    return f"{name}={_value(value, is_pair=is_pair)}" if value else alone.format(name)


def _value(text: str, *, is_pair: bool) -> str:
    """Return the value of an option as Python writes it: a number, a pair of numbers, a dictionary or texts.

    is_pair: whether one number stands for a pair of equal numbers, as in `--band 2`.
    """
    if re.fullmatch(_NUMBER, text):
        return f"({text}, {text})" if is_pair else text
    if text.startswith("'"):
        return text
    name, equals, span = text.rpartition("=")
    if ":" in span and ".py:" not in span:
        pair = f"({', '.join(span.split(':'))})"
        return f'{{"{name}": {pair}}}' if equals else pair
    return re.sub(r"(?<!\S)(?!or )[^\s,]+", r'"\g<0>"', text)


@cache
def _grammar() -> tuple[re.Pattern[str], re.Pattern[str]]:
    """Return two regular expressions: for an option with its value, and for options alone or in a command of hil.

    A value is a number, a range, a quoted text, a file, a name that an option takes or several of them ("dahl or
    boucwen"), or a word before a colon ("--model x: unknown"). Any other word belongs to the sentence.
    """
    from drivers.servo import Quantity
    from ga.evolution.evolution import PRESETS
    from ga.model.terms import TERMS
    from hil.acquisition.excitation import EXCITATIONS

    names = "|".join(sorted({"auto", "sim", *TERMS, *PRESETS, *EXCITATIONS, *Quantity}, key=len, reverse=True))
    name = rf"(?:{names})(?:\+(?:{names}))*(?!\w)"
    values = (
        r"'[^']*'",
        rf"\w+=(?:{_NUMBER}:{_NUMBER}|LOW:HIGH)",
        rf"{_NUMBER}(?::{_NUMBER})?(?![\w.]*\w)",
        r"[\w/]+\.(?:py:\w+|toml|csv|h5)",
        r"[A-Z]{3,}",
        rf"{name}(?:(?:, | or ){name})*",
        r"[^\s:,;]+(?=: |\Z)",
    )
    option = rf"(?<![\w-])--([a-z][a-z-]*[a-z])(?![\w-])(?: ({'|'.join(values)}))?"
    plain = option.replace("([a-z][a-z-]*[a-z])", "[a-z][a-z-]*[a-z]").replace("(?: (", "(?: (?:").replace("|\\Z", "")
    alone = rf"(?P<alone>{plain}(?: {plain})*)"
    command = rf"\bhil (?P<command>[a-z]+)(?P<words>(?: [^\s,;:`()-][^\s,;:`()]*)*)(?P<options>(?: {plain})+)"
    return re.compile(option), re.compile(f"{command}|{alone}")


@cache
def _arguments() -> dict[str, inspect.Parameter]:
    """Return the arguments of the functions that record and identify, by name."""
    from hil import compare, design, identify, record

    functions = (identify, compare, design, record)
    return {one.name: one for each in functions for one in inspect.signature(each).parameters.values()}
