"""CiA 402 drives on CANopen as a `drivers.servo.Servo`: EPOS4, EPOS2 and similar drives. See docs/cia402.md.

In each tick the computer sends a PDO with controlword and set-point, then a SYNC. The drive replies with two PDOs,
sampled at the SYNC: statusword, position and torque in the first, velocity in the second. When needed, our heartbeat is
sent too. Every sixteenth tick also requests temperature or voltage, and does not wait for the reply.

Torque-off is the command `disable voltage`. A quick stop, with the usual option code, would brake and then hold the
shaft.
"""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING

from drivers.canbus.link import BusConfig, CanLink
from drivers.cia402.config import Cia402Config
from drivers.cia402.node import TPDO1, TPDO2, Node
from drivers.cia402.scan import neighbours
from drivers.cia402.states import ENABLE, LIMITING, DriveState, state_of
from drivers.clock import Clock
from drivers.gate import Admitted, DriveServo, to_counts
from drivers.servo import BadReply, DriverError, Limits, NoReply, Quantity, Sample, ServoInfo

if TYPE_CHECKING:
    import can

    from drivers.neighbours import Neighbour
    from drivers.off_path import OffPath

_TRIES = 3
_EVERY = 16
"""Ticks between two requests for a slowly changing value."""
_LARGEST = 32767


class Cia402Servo(DriveServo):
    """One drive that is open and identified, with its PDOs mapped and its torque off.

    clock, bus: given by tests; None uses the real clock and opens the bus of `config`. info.torque_uncertainty is NaN,
    since the drive does not report it. Raises DriverError if the bus cannot be opened or the drive is of another kind,
    NoReply if no drive replies, BadReply if several drives reply.
    """

    def __init__(self, config: Cia402Config, *, clock: Clock | None = None, bus: can.BusABC | None = None) -> None:
        super().__init__(config.sign, clock)
        self._config = config
        self._link = CanLink(BusConfig.of(config), self.clock, bus)
        self._node = Node(config, self._link, self.clock)
        self._settings = self._node.objects.settings
        self._ticks = self._most = 0
        self._temperature = self._voltage = math.nan
        quantities = frozenset({Quantity.TORQUE})
        self._gate = self._node.network.requests.gate(quantities, self._torque_off)
        with self._gate.opening(self._node.stop):
            identity = self._node.nameplate.identify()
            self.disarm()
            self._scale = self._node.nameplate.scale()
            self._node.prepare()
        self.info = ServoInfo(
            backend="cia402",
            model=identity.model,
            serial=identity.serial,
            serial_is_id=not int(identity.serial, 16),  # it reports none
            firmware=identity.firmware,
            quantities=quantities,
            position_lsb=self._scale.position,
            velocity_lsb=self._scale.velocity,
            torque_lsb=self._scale.torque,
            watchdog=config.watchdog,
            watchdog_remedy="set cia402.watchdog = 0.1",
        )

    def _arm(self, limits: Limits) -> None:
        """Write the limits into the drive and read them back, then enable the drive in torque mode at zero torque.

        From then on the drive watches our heartbeat. A latched fault "heartbeat lost" is cleared.
        """
        self._most = min(_LARGEST, math.floor(limits.torque / self._scale.torque * (1.0 + 1e-9)))
        self._node.stop()
        if self._node.away:
            self._node.prepare()
        self._node.clear_faults()
        self._node.limit(limits, self._scale)
        self._node.enable()

    def _exchange(self, admitted: Admitted) -> Sample:
        """Send the set-point and read position, velocity and torque. Raises DeviceFault if the drive has left the state
        OPERATION ENABLED.
        """
        if not self._gate.armed and self._node.away:
            if self._gate.live:  # preparing it would change what its torque does
                return self._read_objects()
            self._node.prepare()
        frames = [] if admitted.command is None else [self._set_point(admitted.command.value)]
        frames += [
            self._node.sync(),
            *(self._node.due_heartbeat() if self._gate.armed else []),
            *self._slow_request(),
        ]
        sent = self.clock.now()
        try:
            replies = self._node.network.requests.ask(frames, ["tpdo1", "tpdo2"])
        except NoReply:
            if self._gate.armed and self._node.away:
                raise self._node.fault_in(DriveState.UNKNOWN) from None
            raise
        return self._decoded(replies["tpdo1"], replies["tpdo2"], (sent, self.clock.now()), saturated=admitted.clipped)

    def neighbours(self) -> list[Neighbour]:
        """See `drivers.neighbours.HasNeighbours`."""
        return neighbours(self._link, self.clock, self._config)

    def off_path(self) -> OffPath:
        """Return the frames that switch the torque off, for another process to send."""
        return self._link.off_path(self._node.off_frames(), self._node.restoring())

    def _restore(self) -> None:
        self._node.restore()

    def _torque_off(self, request: int) -> None:
        """Set zero torque and disable voltage."""
        self._node.stop(wake=request > 0)
        with contextlib.suppress(DriverError):  # a drive that still expects our heartbeat latches a fault
            self._node.release()

    def _set_point(self, torque: float) -> can.Message:
        """Return the PDO that commands `torque`, N m, converted to counts and clamped to the torque limit with which
        the drive is armed.
        """
        counts = to_counts(self._config.sign * torque, self._scale.torque)
        return self._node.set_point(ENABLE, max(-self._most, min(self._most, counts)))

    def _slow_request(self) -> list[can.Message]:
        """Store received replies about temperature and voltage. In every sixteenth tick, return the next request for
        one of them, else nothing.
        """
        kind = self._node.profile
        for place, data in self._node.network.late_replies():
            value = int.from_bytes(data, "little", signed=True)
            if place == kind.temperature:
                self._temperature = value * kind.temperature_unit
            elif place == kind.voltage:
                self._voltage = value * kind.voltage_unit
        self._ticks += 1
        places = [place for place in (kind.temperature, kind.voltage) if place is not None]
        if self._ticks % _EVERY or not places:
            return []
        return [self._node.network.read_request(places[self._ticks // _EVERY % len(places)])]

    def _read_objects(self) -> Sample:
        """Read position, velocity and torque by SDO, for a drive whose PDOs are off."""
        sent = self.clock.now()
        counts = self._node.state()
        return self._scaled(counts, (sent, self.clock.now()))

    def _decoded(self, first: bytes, second: bytes, times: tuple[float, float], *, saturated: bool) -> Sample:
        """Return the sample that both PDOs hold. Raises BadReply, and DeviceFault if an armed drive is not enabled."""
        if len(first) != TPDO1.size or len(second) != TPDO2.size:
            raise BadReply("a PDO has the wrong length: the sample is dropped")
        statusword, position, torque = TPDO1.unpack(first)
        (velocity,) = TPDO2.unpack(second)
        state = state_of(statusword)
        if self._gate.armed and (state is not DriveState.ENABLED or self._node.away):
            raise self._node.fault_in(state)
        limiting = saturated or bool(self._gate.armed and statusword & LIMITING)
        return self._scaled((position, velocity, torque), times, saturated=limiting)

    def _scaled(self, counts: tuple[int, int, int], times: tuple[float, float], *, saturated: bool = False) -> Sample:
        """Return the sample of position, velocity and torque in counts."""
        scale = self._scale
        return self._sample(
            times,
            counts[0] * scale.position,
            counts[1] * scale.velocity,
            counts[2] * scale.torque,
            temperature=self._temperature,
            voltage=self._voltage,
            saturated=saturated,
        )
