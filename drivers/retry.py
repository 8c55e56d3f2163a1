"""Repeat a request whose reply was lost or damaged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from drivers.servo import BadReply, DriverError, NoReply

ATTEMPTS = 3
"""How many times a request is made before the drive counts as silent."""

T = TypeVar("T")


def retry(request: Callable[[], T], on: tuple[type[DriverError], ...] = (NoReply, BadReply)) -> T:
    """Return the result of `request()`. Call it up to three times while it raises an error of the types `on`. Raises
    the last error.
    """
    for _ in range(ATTEMPTS - 1):
        try:
            return request()
        except on:
            continue
    return request()


class Repeats:
    """Repeats a request whose reply was lost, but only inside a block of `active`.

    A servo is opened and armed in such a block: there every request may be repeated safely, and the motor is not driven
    yet. During a run the next tick is the next request, and a torque-off must not wait for repetitions of an earlier
    request.
    """

    def __init__(self) -> None:
        self._on: tuple[type[DriverError], ...] = ()

    @property
    def are_active(self) -> bool:
        """Return whether a block of `active` is being executed."""
        return bool(self._on)

    @contextmanager
    def active(self, on: tuple[type[DriverError], ...] = (NoReply, BadReply)) -> Iterator[None]:
        """Context manager: in its block, requests are repeated when they raise an error of the types `on`."""
        self._on = on
        try:
            yield
        finally:
            self._on = ()

    def __call__(self, request: Callable[[], T]) -> T:
        """Return the result of `request()`, repeated inside a block of `active`. Raises the last error."""
        return retry(request, self._on) if self._on else request()
