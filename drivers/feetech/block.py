"""The block of registers that a tick reads from a Feetech servo, and how a late reply to another request is recognised.

The block holds the addresses 56 to 70, Present Position to Present Current; for an SCS it ends at 66. A reply names
neither its request nor its time. So consecutive requests begin a different number of bytes before the block: a reply of
the wrong length belongs to another request. No length is used again while a lost reply of that length may still arrive.
"""

from __future__ import annotations

from typing import NamedTuple

from drivers.feetech.models import CURRENT_LSB, SPEED_UNIT, FeetechModel, signed

START = 56
_LENGTHS = 6
_LATEST = 1.0
"""s after which a lost reply no longer arrives."""


class FeetechState(NamedTuple):
    """One reading with the servo's own sign.

    raw: position in counts, as the servo reports it. velocity: rad/s. current: A. voltage: V. temperature: degC.
    """

    raw: int
    velocity: float
    current: float
    voltage: float
    temperature: float


class Block:
    """Builds the read requests for the measurements of one servo of `model`, and decodes the replies. speed_unit:
    steps/s in one count of speed.
    """

    def __init__(self, model: FeetechModel) -> None:
        self.speed_unit = 1 if model.family == "scs" else SPEED_UNIT
        self._model = model
        self._size = 15 if model.has_current else 11
        self._big = model.family == "scs"
        self._lost: dict[int, float] = {}
        self._last = 0

    @property
    def velocity_lsb(self) -> float:
        """rad/s in one count of speed."""
        return self.speed_unit * self._model.position_lsb

    def request(self, now: float) -> tuple[int, int]:
        """Return the address and the size that the read at `now`, s, must use."""
        self._lost = {length: until for length, until in self._lost.items() if until > now}
        order = [(self._last + step) % _LENGTHS for step in range(1, _LENGTHS + 1)]
        self._last = next((extra for extra in order if extra not in self._lost), order[0])
        return START - self._last, self._size + self._last

    def lost(self, now: float) -> None:
        """Record that the reply to the last request is missing at `now`, s. It may still arrive."""
        self._lost[self._last] = now + _LATEST

    def state(self, raw: bytes) -> FeetechState:
        """Decode the reply to the last request."""
        data = raw[self._last :]
        return FeetechState(
            self.position(data),
            signed(self._word(data, 2), 15) * self.velocity_lsb,
            signed(self._word(data, 13), 15) * CURRENT_LSB if self._model.has_current else 0.0,
            data[6] * 0.1,
            float(data[7]),
        )

    def position(self, data: bytes) -> int:
        """Return the position in counts from the bytes at `START`."""
        return signed(self._word(data, 0), 15)

    def _word(self, data: bytes, at: int) -> int:
        return int.from_bytes(data[at : at + 2], "big" if self._big else "little")
