"""Asking again where a reply was lost or damaged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from drivers.servo import BadReply, DriverError, NoReply

ATTEMPTS = 3
"""Requests that may be lost one after the other before the drive counts as silent."""

T = TypeVar("T")


def retry(request: Callable[[], T], on: tuple[type[DriverError], ...] = (NoReply, BadReply)) -> T:
    """Return the result of `request`, which is made up to three times while it raises `on`. Raises its last error."""
    for _ in range(ATTEMPTS - 1):
        try:
            return request()
        except on:
            continue
    return request()


class Repeats:
    """Whether a link makes a request again whose reply was lost: only in the block of `active`.

    A servo is opened and armed in such a block, where every request is idempotent and nothing is driven yet. In a run
    the next tick is the next request, and a torque-off must not wait for the third reply to the request before it.
    """

    def __init__(self) -> None:
        self._on: tuple[type[DriverError], ...] = ()

    @contextmanager
    def active(self, on: tuple[type[DriverError], ...] = (NoReply, BadReply)) -> Iterator[None]:
        """Repeat requests in this block while they raise `on`."""
        self._on = on
        try:
            yield
        finally:
            self._on = ()

    def __call__(self, request: Callable[[], T]) -> T:
        """Return the result of `request`. Raises its last error."""
        return retry(request, self._on) if self._on else request()
