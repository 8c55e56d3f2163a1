"""Ask every id on a CAN bus a question that changes nothing, and look at all frames that arrive."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from drivers.servo import BadReply

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import can

    from drivers.canbus.link import CanLink
    from drivers.clock import Clock

_PACE = 2e-3
"""s between two questions: adapters queue few frames, and one on a serial port takes 2 ms for a frame."""
_BITS = 270
"""Bits of a question and its reply, with stuff bits."""


def ask_each(
    link: CanLink,
    clock: Clock,
    bitrate: int,
    questions: Iterable[can.Message],
    take: Callable[[can.Message], None],
    *,
    after: float = 0.05,
) -> None:
    """Send `questions` one by one, and call `take` with every data frame that arrives meanwhile or `after` s later.

    bitrate: bit/s. Raises LinkLost, and NoReply if the bus accepts no frame.
    """
    for question in questions:
        link.send(question)
        listen(link, clock, max(_PACE, _BITS / bitrate), take)
    listen(link, clock, after, take)


def listen(link: CanLink, clock: Clock, seconds: float, take: Callable[[can.Message], None]) -> None:
    """Call `take` with every data frame that arrives within `seconds`. Damaged frames are dropped. Raises LinkLost."""
    end = clock.now() + seconds
    while clock.now() < end:
        with contextlib.suppress(BadReply):
            message = link.receive(end)
            if message is not None and not message.is_remote_frame:
                take(message)
