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

from drivers.canbus.link import CanLink
from drivers.cia402.config import Cia402Config
from drivers.cia402.node import TPDO1, TPDO2, Node
from drivers.cia402.scan import neighbours
from drivers.cia402.states import ENABLE, LIMITING, DriveState, state_of
from drivers.clock import Clock, MonotonicClock
from drivers.gate import to_counts
from drivers.servo import BadReply, Command, DriverError, Limits, NoReply, Quantity, Sample, ServoInfo, Status

if TYPE_CHECKING:
    from collections.abc import Callable

    import can

    from drivers.neighbours import Neighbour
    from drivers.off_path import OffPath

_TRIES = 3
_EVERY = 16
"""Ticks between two requests for a slowly changing value."""
_LARGEST = 32767


class Cia402Servo:
    """One drive that is open and identified, with its PDOs mapped and its torque off.

    clock, bus: given by tests; None uses the real clock and opens the bus of `config`. info.torque_uncertainty is NaN,
    since the drive does not report it. Raises DriverError if the bus cannot be opened or the drive is of another kind,
    NoReply if no drive replies, BadReply if several drives reply.
    """

    def __init__(self, config: Cia402Config, *, clock: Clock | None = None, bus: can.BusABC | None = None) -> None:
        self._config = config
        self.clock: Clock = clock or MonotonicClock()
        self._link = CanLink(config.bus, self.clock, bus)
        self._node = Node(config, self._link, self.clock)
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

    def arm(self, limits: Limits) -> None:
        """Write the limits into the drive and read them back, then enable the drive in torque mode at zero torque.

        From then on the drive watches our heartbeat. A latched fault "heartbeat lost" is cleared. Raises DeviceFault if
        another fault is latched, DriverError if the drive refuses a limit or is not enabled. The torque is off after an
        error.
        """
        self._most = min(_LARGEST, math.floor(limits.torque / self._scale.torque * (1.0 + 1e-9)))
        with self._gate.arming(limits):
            self._node.stop()
            if self._node.away:
                self._node.prepare()
            self._node.clear_faults()
            self._node.limit(limits, self._scale)
            self._node.enable()

    def exchange(self, command: Command) -> Sample:
        """Send the set-point and read position, velocity and torque in one round trip.

        Raises UnsafeCommand, NoReply, BadReply, LinkLost, and DeviceFault if the drive is in fault, has restarted, or
        has left the state OPERATION ENABLED.
        """
        admitted = self._gate.admit(command)
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
        received = self.clock.now()
        return self._sample(replies["tpdo1"], replies["tpdo2"], sent, received, saturated=admitted.clipped)

    def disarm(self) -> None:
        """Set zero torque and disable voltage until the drive confirms it. Raises DriverError if the drive does not
        confirm it.
        """
        self._gate.disarm()

    def close(self) -> None:
        """Switch the torque off, restore the objects, and close the bus. Never raises DriverError."""
        self._gate.close(self._node.restore)

    def fall_silent(self) -> None:
        """See `Gate.fall_silent`."""
        self._gate.fall_silent()

    def neighbours(self) -> list[Neighbour]:
        """See `drivers.neighbours.HasNeighbours`."""
        return neighbours(self._link, self.clock, self._config)

    def off_path(self) -> OffPath:
        """Return the frames that switch the torque off, for another process to send."""
        return self._link.off_path(self._node.off_frames(), self._node.restoring())

    def keep_journal(self, journal: Callable[[], None]) -> None:
        """Call `journal` before each write of a setting."""
        self._node.objects.settings.journal = journal

    def _torque_off(self, request: int) -> None:
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
        position, velocity, torque = self._node.state()
        sign, scale = self._config.sign, self._scale
        self.info.check_readings(position * scale.position, velocity * scale.velocity, torque * scale.torque)
        return Sample(
            t=sent,
            t_read=0.5 * (sent + self.clock.now()),
            motor_position=sign * position * scale.position,
            motor_velocity=sign * velocity * scale.velocity,
            motor_torque=sign * torque * scale.torque,
            temperature=self._temperature,
            voltage=self._voltage,
        )

    def _sample(self, first: bytes, second: bytes, sent: float, received: float, *, saturated: bool) -> Sample:
        if len(first) != TPDO1.size or len(second) != TPDO2.size:
            raise BadReply("a PDO has the wrong length: the sample is dropped")
        statusword, position, torque = TPDO1.unpack(first)
        (velocity,) = TPDO2.unpack(second)
        state = state_of(statusword)
        if self._gate.armed and (state is not DriveState.ENABLED or self._node.away):
            raise self._node.fault_in(state)
        sign, scale = self._config.sign, self._scale
        self.info.check_readings(position * scale.position, velocity * scale.velocity, torque * scale.torque)
        limiting = saturated or bool(self._gate.armed and statusword & LIMITING)
        return Sample(
            t=sent,
            t_read=0.5 * (sent + received),
            motor_position=sign * position * scale.position,
            motor_velocity=sign * velocity * scale.velocity,
            motor_torque=sign * torque * scale.torque,
            temperature=self._temperature,
            voltage=self._voltage,
            status=Status.SATURATED if limiting else Status(0),
        )
