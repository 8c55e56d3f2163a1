"""Asking again where a reply was lost or damaged."""

from __future__ import annotations

from collections.abc import Callable
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
