"""The communication of an emulated CANopen device: NMT, heartbeat producer and consumer, SYNC, PDOs, EMCY and SDO.

Source: CiA 301. Two things that CiA 301 leaves open are chosen here. A boot takes `BOOT` s. A PDO of type 254 or 255 is
sent when its contents have changed; this is checked when a frame is received and when the device sends by itself.
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, Protocol

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.canopen.dictionary import (
    NO_OBJECT,
    NOT_MAPPABLE,
    NOT_NOW,
    PDO_TOO_LONG,
    RANGE,
    SIZES,
    STRING,
    WRONG_STATE,
    Abort,
    Dictionary,
)
from sim_backend.wire.canopen.sdo import SdoServer

if TYPE_CHECKING:
    from collections.abc import Iterator

BOOT = 0.5
BOOTING, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F
HEARTBEAT_LOST = 0x8130
_OFF = 1 << 31
_RPDO, _RPDO_MAP, _TPDO, _TPDO_MAP = 0x1400, 0x1600, 0x1800, 0x1A00


class Application(Protocol):
    """The interface of a device's application: everything in the device except its communication."""

    def receive(self, index: int, sub: int, value: int, now: float) -> None:
        """Handle an object that a PDO has written."""

    def connection_lost(self, code: int, now: float) -> None:
        """Handle the loss of a heartbeat (code: its EMCY code), or an NMT stop or communication reset (code: 0)."""

    def restarted(self, now: float) -> None:
        """Handle an NMT reset of the whole node."""


class CanopenNode:
    """The communication of the node `ident`. Times are s on the bus's clock. At `now` the node is powered and
    pre-operational.

    saved: the values that "store parameters" stored; a reset restores them.
    """

    def __init__(self, ident: int, dictionary: Dictionary, application: Application, now: float) -> None:
        self.ident = ident
        self.objects = dictionary
        self.state = PRE_OPERATIONAL
        self._application = application
        self._sdo = SdoServer(dictionary)
        self._pending: list[CanFrame] = []
        self._ready = now
        self._beat = math.inf
        self._heard: dict[int, float] = {}
        self._synced: dict[int, bytes] = {}
        self._sent: dict[int, bytes] = {}
        self._syncs = 0
        self.saved = dict(dictionary.values)
        for index in (*range(_RPDO, _RPDO + 4), *range(_TPDO, _TPDO + 4)):
            dictionary.write_hooks[index] = self._pdo_parameter_written
        for index in (*range(_RPDO_MAP, _RPDO_MAP + 4), *range(_TPDO_MAP, _TPDO_MAP + 4)):
            dictionary.write_hooks[index] = self._mapping_written
        dictionary.write_hooks[0x1016] = self._consumer_written

    # -- time -------------------------------------------------------------------------------------------------------

    def due(self) -> float:
        """Return the time at which the node must next send or act without a request, s."""
        return min(self._ready if self._pending else math.inf, self._beat, self._lapse())

    def unasked(self, now: float) -> list[CanFrame]:
        """Return the boot-up message, heartbeats and EMCYs that are to be sent at `now`."""
        self.advance(now)
        if now < self._ready:
            return []
        out, self._pending = self._pending, []
        if self.state == BOOTING:
            self.state = PRE_OPERATIONAL
        if self._beat <= now:
            out.append(CanFrame(0x700 + self.ident, bytes([self.state])))
            period = self.objects.get(0x1017) * 1e-3
            self._beat = self._beat + period if period else math.inf
        return out + self._changed()

    def advance(self, now: float) -> None:
        """Detect the loss of a watched heartbeat, and apply a newly written period of the node's own heartbeat."""
        if self._lapse() <= now:
            self._heard.clear()
            self._application.connection_lost(HEARTBEAT_LOST, now)
        period = self.objects.get(0x1017) * 1e-3
        if period and math.isinf(self._beat):
            self._beat = max(now, self._ready)
        elif not period:
            self._beat = math.inf

    @property
    def watches(self) -> bool:
        """Return whether the node watches the heartbeat of another node."""
        return math.isfinite(self._lapse())

    def _lapse(self) -> float:
        """Return the time at which the first watched heartbeat will be overdue, s."""
        return min((self._heard[n] + t for n, t in self._consumed() if n in self._heard), default=math.inf)

    def _consumed(self) -> Iterator[tuple[int, float]]:
        for sub in (1, 2):
            value = self.objects.get(0x1016, sub)
            node, milliseconds = value >> 16 & 0x7F, value & 0xFFFF
            if node and milliseconds:
                yield node, milliseconds * 1e-3

    # -- received frames --------------------------------------------------------------------------------------------

    def handle(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """Return the replies to a frame."""
        if frame.extended or frame.error or frame.remote or now < self._ready or self.state == BOOTING:
            return []
        if frame.ident == 0x000:
            self._commanded(frame.data, now)
        elif frame.ident == 0x600 + self.ident and self.state != STOPPED:
            reply = self._sdo.answer(frame.data)
            if reply is not None:
                return [CanFrame(0x580 + self.ident, reply), *self._changed()]
        elif frame.ident == 0x080 and self.state == OPERATIONAL:
            return self._sync(now)
        elif 0x700 < frame.ident <= 0x77F:
            self._heard[frame.ident - 0x700] = now
        elif self.state == OPERATIONAL:
            self._receive_pdo(frame, now)
        return self._changed()

    def emergency(self, code: int) -> None:
        """Send an EMCY with an error code; code 0 means that no error is left."""
        if self.state in {OPERATIONAL, PRE_OPERATIONAL}:
            data = struct.pack("<HB5x", code, self.objects.get(0x1001))
            self._pending.append(CanFrame(0x080 + self.ident, data))

    def reset(self, now: float, *, application: bool) -> None:
        """Reset the node, by NMT or by a loss of power: the stored values are restored.

        application: whether the whole node is reset, and not only its communication.
        """
        for (index, sub), value in self.saved.items():
            if (application or 0x1000 <= index < 0x2000) and index != 0x1003:
                self.objects.values[index, sub] = value
        self._heard.clear()
        self._synced.clear()
        self._sent.clear()
        self._beat = math.inf
        self.state = BOOTING
        self._ready = now + (BOOT if application else 0.0)
        self._pending = [CanFrame(0x700 + self.ident, b"\0")]

    def _commanded(self, data: bytes, now: float) -> None:
        if len(data) != 2 or data[1] not in {0, self.ident}:
            return
        match data[0]:
            case 0x01:
                self.state = OPERATIONAL
                self._sent.clear()
            case 0x02:
                self.state = STOPPED
                self._application.connection_lost(0, now)
            case 0x80:
                self.state = PRE_OPERATIONAL
            case 0x81:
                self._application.restarted(now)
                self.reset(now, application=True)
            case 0x82:
                self._application.connection_lost(0, now)
                self.reset(now, application=False)

    # -- PDOs -------------------------------------------------------------------------------------------------------

    def _receive_pdo(self, frame: CanFrame, now: float) -> None:
        for number in range(4):
            if self.objects.get(_RPDO + number, 1) == frame.ident:
                if self.objects.get(_RPDO + number, 2) <= 240:
                    self._synced[number] = frame.data
                else:
                    self._unpack(number, frame.data, now)

    def _unpack(self, number: int, data: bytes, now: float) -> None:
        at = 0
        for index, sub, size in self._mapped(_RPDO_MAP + number):
            part = data[at : at + size]
            if len(part) < size:
                self.emergency(0x8210)
                return
            kind = self.objects.entries[index, sub].kind
            value = int.from_bytes(part, "little", signed=kind in {2, 3, 4})
            self.objects.put(index, sub, value)
            self._application.receive(index, sub, value, now)
            at += size

    def _sync(self, now: float) -> list[CanFrame]:
        waiting, self._synced = self._synced, {}
        for number, data in waiting.items():
            self._unpack(number, data, now)
        self._syncs += 1
        out = []
        for number, cob, kind in self._enabled():
            if 1 <= kind <= 240 and self._syncs % kind == 0:
                out.append(CanFrame(cob, self._packed(number)))
        return out

    def _changed(self) -> list[CanFrame]:
        """Return the event-driven PDOs whose contents have changed."""
        if self.state != OPERATIONAL:
            return []
        out = []
        for number, cob, kind in self._enabled():
            if kind >= 254 and (data := self._packed(number)) != self._sent.get(number):
                self._sent[number] = data
                out.append(CanFrame(cob, data))
        return out

    def _enabled(self) -> Iterator[tuple[int, int, int]]:
        for number in range(4):
            cob = self.objects.get(_TPDO + number, 1)
            if not cob & _OFF and self.objects.get(_TPDO_MAP + number, 0):
                yield number, cob & 0x7FF, self.objects.get(_TPDO + number, 2)

    def _packed(self, number: int) -> bytes:
        return b"".join(self.objects.encoded(i, s) for i, s, _ in self._mapped(_TPDO_MAP + number))

    def _mapped(self, mapping: int) -> Iterator[tuple[int, int, int]]:
        """Yield index, sub-index and number of bytes of each object that a PDO carries. mapping: index of the PDO's
        mapping object.
        """
        for place in range(1, self.objects.get(mapping, 0) + 1):
            value = self.objects.get(mapping, place)
            yield value >> 16, value >> 8 & 0xFF, (value & 0xFF) // 8

    def _pdo_parameter_written(self, _index: int, sub: int, value: int) -> None:
        if sub == 1 and not value & _OFF and not 0x181 <= value & 0x7FF <= 0x57F:
            raise Abort(RANGE)
        if sub == 1 and not value & _OFF and self.state == OPERATIONAL:
            raise Abort(WRONG_STATE)

    def _mapping_written(self, index: int, sub: int, value: int) -> None:
        parameter = index - 0x200
        if not self.objects.get(parameter, 1) & _OFF and self.state == OPERATIONAL:
            raise Abort(WRONG_STATE)
        if sub == 0:
            mapped = [self.objects.get(index, place) for place in range(1, value + 1)]
            if 0 in mapped:
                raise Abort(NO_OBJECT)
            if sum(entry & 0xFF for entry in mapped) > 64:
                raise Abort(PDO_TOO_LONG)
            return
        if self.objects.get(index, 0):
            raise Abort(NOT_NOW)
        entry = self.objects.entries.get((value >> 16, value >> 8 & 0xFF))
        if value and (entry is None or not entry.mappable or entry.kind == STRING):
            raise Abort(NOT_MAPPABLE)
        if value and entry is not None and SIZES[entry.kind] * 8 != value & 0xFF:
            raise Abort(NOT_MAPPABLE)

    def _consumer_written(self, _index: int, _sub: int, value: int) -> None:
        self._heard.pop(value >> 16 & 0x7F, None)  # it is watched from its next beat on
