"""CubeMars AK and Damiao motors, which use the frames of the MIT mini-cheetah, as a `drivers.servo.Servo`. Limits:
docs/can.md.

A tick is one frame each way: a command with a torque (kp and kd are zero), and a reply with position, velocity and
torque. A disarmed motor is sent no torque.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from drivers.canbus.counts import require_position
from drivers.canbus.link import BusConfig, CanLink
from drivers.clock import Clock
from drivers.gate import Admitted, DriveServo, below_one_count
from drivers.mit.config import MitConfig
from drivers.mit.frames import DISABLED, ENABLED, LOST_COMMUNICATION, MitState, fault, models
from drivers.mit.motor import MitMotor
from drivers.servo import DriverError, Limits, Quantity, Sample, ServoInfo

if TYPE_CHECKING:
    import can

    from drivers.neighbours import Neighbour
    from drivers.off_path import OffPath

_QUANTITIES = frozenset({Quantity.TORQUE})
_TIMEOUT_LSB = 50e-6
_COOLEST_LIMIT = 80.0
"""degC: the lowest over-temperature limit that a Damiao accepts."""
_IGNORED = 10
"""Number of consecutive ticks with a wrong torque after which a motor counts as restarted."""


class MitServo(DriveServo):
    """One motor that is open and identified, with its torque off.

    clock, bus: given by tests; None uses the real clock and opens the bus of `config`. info.torque_uncertainty is NaN
    if stand.toml states torque_scale. Raises DriverError if the bus cannot be opened or another model replies, NoReply
    if no motor replies, BadReply if several motors reply.
    """

    def __init__(self, config: MitConfig, *, clock: Clock | None = None, bus: can.BusABC | None = None) -> None:
        super().__init__(config.sign, clock)
        self._config = config
        self._link = CanLink(BusConfig.of(config), self.clock, bus)
        self._motor = MitMotor(config, self._link, self.clock)
        self._settings = self._motor.settings
        self._ignored = 0
        self._gate = self._motor.requests.gate(_QUANTITIES, self._torque_off)
        with self._gate.opening(self._motor.send_leave):
            self.info = self._describe(self._motor.identify())
        self._gate.live = False

    def _arm(self, limits: Limits) -> None:
        """Write the limits and the timeout into a Damiao and read them back, then enter motor mode at zero torque.

        An AK has no frame that sets limits. A Damiao's error "lost communication" is cleared.
        """
        if limits.torque < self.info.torque_lsb:
            raise below_one_count(limits.torque, self.info.torque_lsb, self._config.model)
        self._check_error(self._motor.leave())
        if self._motor.damiao:
            self._prepare(limits)
        self._enable()
        self._ignored = 0

    def _exchange(self, admitted: Admitted) -> Sample:
        """Send the set-point and read the state. Raises DeviceFault also if the motor has not followed the command for
        ten ticks.
        """
        counts, saturated = (None, False) if admitted.command is None else self._counts(admitted.command.value)
        sent = self.clock.now()
        state = self._motor.look() if counts is None else self._motor.drive(counts)
        received = self.clock.now()
        self._check_error(state)
        if counts is not None:
            self._check_follows(counts, state)
        require_position(state.position)
        # the read that switches a live AK off says nothing of the torque before it
        unknown = counts is None and self._gate.live and not self._motor.damiao
        return self._sample(
            (sent, received),
            state.position,
            state.velocity,
            None if unknown else state.torque * self._config.torque_scale,
            temperature=state.temperature - self._config.temperature_offset,
            saturated=saturated or admitted.clipped,
        )

    def neighbours(self) -> list[Neighbour] | None:
        """See `drivers.neighbours.HasNeighbours`."""
        return self._motor.neighbours()

    def off_path(self) -> OffPath:
        """Return the frames that switch the torque off, for another process to send."""
        return self._link.off_path(self._motor.off_frames(), self._motor.restoring())

    def _torque_off(self, _request: int) -> None:
        """Leave motor mode. An AK does not report whether it is enabled: its reply to the frame is the confirmation."""
        self._motor.send_leave()  # before `leave`, which waits for replies that are still due
        if self._motor.leave().status == ENABLED and self._motor.damiao:
            self._motor.drive(self._motor.codec.torque.of(0.0))  # it may still obey that
            raise DriverError("it is still enabled")

    def _describe(self, firmware: str) -> ServoInfo:
        codec, model = self._motor.codec, models()[self._config.model]
        return ServoInfo(
            backend="mit",
            model=self._config.model,
            serial=f"id {self._config.id}",
            serial_is_id=True,
            firmware=firmware,
            quantities=_QUANTITIES,
            position_lsb=codec.position.lsb,
            velocity_lsb=codec.velocity.lsb,
            torque_lsb=codec.torque.lsb * self._config.torque_scale,
            torque_most=2.0 * self._config.largest_torque,
            torque_uncertainty=model.torque_uncertainty if self._config.torque_scale == 1.0 else math.nan,
            watchdog=self._config.watchdog if self._motor.damiao else 0.0,  # an AK's cannot be read over CAN
            watchdog_remedy="set mit.watchdog = 0.1" if self._motor.damiao else "",
        )

    def _prepare(self, limits: Limits) -> None:
        """Write the limits for which a Damiao has registers. The limits of speed and temperature are only lowered,
        never raised.
        """
        motor = self._motor
        motor.require("control_mode", 1)
        motor.require("over_temperature", min(motor.get("over_temperature"), max(limits.temperature, _COOLEST_LIMIT)))
        motor.require("max_speed", min(motor.get("max_speed"), limits.velocity))
        motor.require("timeout", math.ceil(self._config.watchdog / _TIMEOUT_LSB - 1e-9))

    def _enable(self) -> None:
        zero = self._motor.codec.torque.of(0.0)
        self._check_error(self._motor.enter())
        state = self._motor.drive(zero)
        if self._motor.damiao and state.status != ENABLED:
            raise DriverError("the motor refuses to be enabled: switch its power off and on")

    def _counts(self, torque: float) -> tuple[int, bool]:
        """Return `torque`, N m, in counts, and whether the motor's range clipped it."""
        asked = self._config.sign * torque / self._config.torque_scale
        return self._motor.codec.torque.of(asked), abs(asked) > self._config.ranges[2]

    def _check_error(self, state: MitState) -> None:
        """Raise DeviceFault if the motor reports an error.

        The error "lost communication" of a disarmed Damiao is cleared instead.
        """
        status, family = state.status, self._motor.codec.family
        armed = self._gate.armed
        if family == "cubemars":
            if status:
                raise fault(family, status)
        elif status == LOST_COMMUNICATION and not armed:
            self._motor.clear()
        elif status not in {DISABLED, ENABLED} or (armed and status == DISABLED):
            raise fault(family, status)

    def _check_follows(self, counts: int, state: MitState) -> None:
        """Raise DeviceFault if the torque has differed from the commanded `counts` for too many ticks.

        An AK that has restarted does not report so; it only stops following the command.
        """
        lsb = self._motor.codec.torque.lsb
        asked = (counts - self._motor.codec.torque.of(0.0)) * lsb
        follows = abs(state.torque - asked) <= 0.5 * abs(asked) + 4.0 * lsb
        self._ignored = 0 if follows else self._ignored + 1
        if self._ignored >= _IGNORED:
            raise fault(self._motor.codec.family, DISABLED)
