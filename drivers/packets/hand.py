"""The other servos of a hand on the same serial line: they are watched during a run and switched off with the driven
servo.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING

from drivers.neighbours import Swing, check_still
from drivers.retry import ATTEMPTS, retry
from drivers.servo import BadReply, DeviceFault, DriverError, LinkLost, NoReply

if TYPE_CHECKING:
    from drivers.packets.bus import Bus
    from drivers.packets.control_table import Register

_EVERY = 10
"""Exchanges between two readings of a neighbour: one neighbour is read at a time, so that a tick stays short."""


class HandBus:
    """The neighbours of the servo `ident`: the servos of the same hand on its line. There are none before `join`.

    bus: to the driven servo. torque: the register Torque Enable. position: address and size of the present position,
    which `counts` decodes. turn: counts after which a position begins again at zero, 0 if it never does. Registers and
    counts are the same in all servos of the line.
    """

    def __init__(
        self,
        bus: Bus,
        ident: int,
        *,
        torque: Register,
        position: tuple[int, int],
        counts: Callable[[bytes], int],
        turn: int,
    ) -> None:
        self.watches = False
        """Whether the driven servo is armed and has neighbours."""
        self._bus, self._ident, self._torque = bus, ident, torque
        self._position, self._counts = position, counts
        self._names: dict[int, str] = {}
        self._ways: dict[int, Bus] = {}
        self._alerts: dict[int, int] = {}
        self._swings: dict[int, Swing] = {}
        self._turn = turn
        self._exchanges = self._lost = 0

    def join(self, joints: Mapping[str, int]) -> None:
        """Set the servos of the hand: their ids by the names of their joints."""
        self._names = {ident: name for name, ident in joints.items() if ident != self._ident}
        self._ways = {}

    @property
    def neighbours(self) -> tuple[int, ...]:
        """The ids of the neighbours."""
        return tuple(self._names)

    def begin(self, raw: int) -> None:
        """Read the position of every neighbour. From now on `switch_off` switches off the whole hand. raw: position of
        the driven servo, counts.

        Raises LinkLost, and DriverError with the name of a neighbour that does not reply.
        """
        self._swings = {ident: Swing(self._turn) for ident in (self._ident, *self._names)}
        self._swings[self._ident].begin(raw)
        for ident, data in self._positions():
            self._swings[ident].begin(self._counts(data))
            self._alerts[ident] = self._ways[ident].alert
        self._exchanges = self._lost = 0
        self.watches = bool(self._names)

    def slower(self, set_point: int) -> tuple[float, float]:
        """See `drivers.neighbours.SeesNeighbours`. set_point: bytes of the packet of a set-point."""
        if not self._names:
            return 0.0, 0.0
        list(self._positions())  # the first read of each waits until the line is silent
        times = [self._bus.clock.now(), *(self._bus.clock.now() for _ in self._positions())]
        each = min(after - before for before, after in pairwise(times))  # a busy computer makes some of them longer
        write = self._bus.duration(set_point)
        return write + each / _EVERY, write + each

    def _positions(self) -> Iterator[tuple[int, bytes]]:
        """Yield id and position of every neighbour. Raises LinkLost, and DriverError for one that does not reply."""
        for ident in self._names:
            way = self._ways.setdefault(ident, self._bus.beside(ident))
            try:
                data = retry(lambda way=way: way.read(*self._position))  # type: ignore[misc]  # of this turn of the loop
            except LinkLost:
                raise
            except DriverError as error:
                raise DriverError(
                    f"{self._called(ident)} of this hand does not answer ({error}), so that it could not be switched "
                    "off: nothing was driven; check its power, its cable and its id in the hand file"
                ) from None
            yield ident, data

    def look(self, raw: int) -> None:
        """Note the position `raw`, counts, of the driven servo; read one neighbour every tenth time.

        Raises LinkLost; DeviceFault if a neighbour reports a new error; DriverError if a neighbour has not replied
        three times, or turns although another joint is driven.
        """
        turned = self._swings[self._ident].note(raw)
        self._exchanges += 1
        if self._exchanges % _EVERY and not self._lost:
            return
        ident = next(iter(self._ways))
        way = self._ways[ident]
        try:
            data = way.read(*self._position)
        except (NoReply, BadReply) as error:
            self._lost += 1
            if self._lost < ATTEMPTS:
                return
            raise DriverError(f"{self._called(ident)} of this hand does not answer any more ({error})") from None
        self._lost = 0
        self._ways[ident] = self._ways.pop(ident)  # the next one in turn is now the first
        if alert := way.alert & ~self._alerts[ident]:
            raise DeviceFault(alert, f"{self._called(ident)} of this hand reports an error (0x{alert:02x})")
        check_still(f"servo {self._ident}", turned, self._called(ident), self._swings[ident].note(self._counts(data)))

    def turned(self, count: float) -> dict[str, float]:
        """See `drivers.neighbours.SeesNeighbours`. count: rad in one count."""
        return {self._names[ident]: count * self._swings[ident].range for ident in self._names if ident in self._swings}

    def switch_off(self, driven: Callable[[], None]) -> None:
        """Switch off the torque of every servo of the hand with one packet, then wait for each one's confirmation.

        driven: switches the driven servo off and waits for its confirmation; before `begin`, only this is called.
        Raises LinkLost, and DriverError that names every servo that does not confirm.
        """
        if not self.watches:
            driven()
            return
        with contextlib.suppress(DriverError):
            self._bus.send(self._torque.address, self._torque.encoded(0), self.neighbours)
        wrong = []
        try:
            driven()
        except LinkLost:
            raise
        except DriverError as error:
            wrong.append(f"servo {self._ident}: {error}")
        for ident, way in self._ways.items():
            try:
                if self._torque.decoded(way.read(self._torque.address, self._torque.size)):
                    wrong.append(f"{self._called(ident)} is still on")
            except LinkLost:
                raise
            except DriverError as error:
                wrong.append(f"{self._called(ident)}: {error}")
        if wrong:
            raise DriverError("; ".join(wrong))
        self.watches = False

    def _called(self, ident: int) -> str:
        return f"servo {ident} ({self._names[ident]})"
