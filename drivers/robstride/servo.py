"""A RobStride motor in its private protocol as a `drivers.servo.Servo`. Limits: docs/robstride.md.

A tick is one frame each way: an operation frame with a torque and both gains zero, and a feedback with angle, velocity,
torque and mode. Current mode is not used, because its set-points are parameters in A, whose torque depends on the
motor's torque constant. A disarmed motor is sent no torque.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from drivers.canbus.counts import require_position
from drivers.canbus.link import BusConfig, CanLink
from drivers.clock import Clock
from drivers.gate import Admitted, DriveServo, below_one_count
from drivers.robstride.config import RobstrideConfig
from drivers.robstride.frames import RESTARTED, RUNNING, STOPPED, WATCHDOG, RobstrideState, fault, models
from drivers.robstride.motor import RobstrideMotor
from drivers.servo import DeviceFault, DriverError, Limits, Quantity, Sample, ServoInfo

if TYPE_CHECKING:
    import can

    from drivers.off_path import OffPath

_QUANTITIES = frozenset({Quantity.TORQUE})
_TIMEOUT_LSB = 1.0 / 20_000.0


class RobstrideServo(DriveServo):
    """One motor that is open and identified, with its torque off.

    clock, bus: given by tests; None uses the real clock and opens the bus of `config`. info.torque_uncertainty is NaN
    if stand.toml states torque_scale. Raises DriverError if the bus cannot be opened, or for another model or protocol,
    NoReply if no motor replies, BadReply if several reply, DeviceFault if another program commands the motor.
    """

    def __init__(self, config: RobstrideConfig, *, clock: Clock | None = None, bus: can.BusABC | None = None) -> None:
        super().__init__(config.sign, clock)
        self._config = config
        self._timeout = float(math.ceil(config.watchdog / _TIMEOUT_LSB - 1e-9))
        self._link = CanLink(BusConfig.of(config), self.clock, bus)
        self._motor = RobstrideMotor(config, self._link, self.clock)
        self._settings = self._motor.settings
        self._gate = self._motor.requests.gate(_QUANTITIES, self._torque_off)
        with self._gate.opening(self._motor.send_stop):
            self.info = self._describe(*self._motor.identify())
        self._gate.live = False

    def _arm(self, limits: Limits) -> None:
        """Write operation mode, torque limit and watchdog, read each back, and start the motor at zero torque. Raises
        DeviceFault also if another program commands the motor.
        """
        if limits.torque < self.info.torque_lsb:
            raise below_one_count(limits.torque, self.info.torque_lsb, self._config.model)
        motor, settings = self._motor, self._motor.settings
        motor.forget()
        self._check(motor.stop())
        settings.require("run_mode", 0.0)
        most = limits.torque / self._config.torque_scale
        settings.require("limit_torque", min(motor.get("limit_torque"), most))
        if self._config.watchdog:
            settings.require("canTimeout", self._timeout)
        self._check(motor.enable())
        if motor.drive(motor.codec.torque.of(0.0)).mode != RUNNING:
            raise DriverError("the motor refuses to run: switch its power off and on")

    def _exchange(self, admitted: Admitted) -> Sample:
        """Send the set-point and read the state. Raises DeviceFault also if another program commands the motor."""
        counts, saturated = (None, False) if admitted.command is None else self._counts(admitted.command.value)
        sent = self.clock.now()
        if counts is not None:
            state = self._motor.drive(counts)
        else:
            state = self._motor.look() if self._gate.live else self._motor.stop()
        received = self.clock.now()
        self._check(state)
        require_position(state.position)
        return self._sample(
            (sent, received),
            state.position,
            state.velocity,
            state.torque * self._config.torque_scale,
            temperature=state.temperature,
            saturated=saturated or admitted.clipped,
        )

    def off_path(self) -> OffPath:
        """Return the frames that switch the torque off, for another process to send."""
        return self._link.off_path(self._motor.off_frames(), self._motor.restoring())

    def _torque_off(self, _request: int) -> None:
        self._motor.send_stop()  # before `stop`, which waits for replies that are still due
        if self._motor.stop().mode != STOPPED:
            self._motor.drive(self._motor.codec.torque.of(0.0))  # it may still obey that
            raise DriverError("it still runs")

    def _describe(self, serial: str, version: tuple[int, ...]) -> ServoInfo:
        codec, scale = self._motor.codec, self._config.torque_scale
        model = models()[self._config.model]
        return ServoInfo(
            backend="robstride",
            model=self._config.model,
            serial=serial,
            firmware=".".join(map(str, version)),
            quantities=_QUANTITIES,
            position_lsb=codec.position.lsb,
            velocity_lsb=codec.velocity.lsb,
            torque_lsb=codec.torque.lsb * scale,
            torque_most=2.0 * self._config.largest_torque,
            torque_uncertainty=model.torque_uncertainty if scale == 1.0 else math.nan,
            watchdog=self._config.watchdog,
            watchdog_remedy="set robstride.watchdog = 0.1",
        )

    def _counts(self, torque: float) -> tuple[int, bool]:
        """Return `torque`, N m, in counts, and whether the motor's range clipped it."""
        codec = self._motor.codec
        asked = self._config.sign * torque / self._config.torque_scale
        return codec.torque.of(asked), abs(asked) > codec.torque.most

    def _check(self, state: RobstrideState) -> None:
        """Raise DeviceFault if the motor reports a fault, if another program commands it, or if it does not run while
        armed.
        """
        self._motor.check_host()
        if state.faults or self._motor.reported:
            raise fault(state.faults, self._motor.reported)
        if not self._gate.armed or state.mode == RUNNING:
            return
        # a restarted motor has lost the time that was written
        if self._config.watchdog and self._motor.get("canTimeout") == self._timeout:
            silence = f"it received nothing for its canTimeout of {self._config.watchdog:g} s"
            raise DeviceFault(WATCHDOG, f"the motor stopped: {silence}; find out what delayed the computer or the bus")
        raise DeviceFault(RESTARTED, "the motor stopped without a fault: it has restarted; check its supply and plug")
