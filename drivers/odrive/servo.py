"""ODrive on CANSimple, behind `drivers.servo.Servo`. Wiring and limits: docs/can.md.

A tick is the set-point (`Set_Input_Torque`) and two remote frames behind it, for the encoder's estimates and for the
torque; every eighth tick asks for temperature, voltage or errors as well and takes the answer when it comes. What the
axis sends unasked, its heartbeat first of all, is taken in on the way.

Firmware 0.6 says the torque itself (`Get_Torques`); 0.5.6 says the current, which `torque_constant` turns into torque.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

from drivers.canbus.link import CanLink
from drivers.clock import Clock, MonotonicClock
from drivers.gate import Gate
from drivers.odrive.axis import Axis
from drivers.odrive.config import OdriveConfig
from drivers.odrive.messages import (
    CLOSED_LOOP,
    IDLE,
    PASSTHROUGH,
    TORQUE_CONTROL,
    fault,
    watchdog_bit,
)
from drivers.odrive.parameters import Parameters
from drivers.servo import BadReply, Command, DriverError, Limits, Quantity, Sample, ServoInfo, Status

if TYPE_CHECKING:
    import can

_TURN = 2.0 * math.pi
_STATE_CHANGE = 0.35
"""s that an axis may take to say in a heartbeat that it has changed its state."""
_TRIES = 3
_EVERY = 8
"""Ticks between two questions for what changes slowly."""


class OdriveServo:
    """One axis, opened, identified, and idle.

    clock and bus are those of the machine unless a test brings its own. Raises DriverError where the bus cannot be
    opened or the firmware does not fit, NoReply where nobody answers, BadReply where several do.
    """

    def __init__(self, config: OdriveConfig, *, clock: Clock | None = None, bus: can.BusABC | None = None) -> None:
        self._config = config
        self._clock = clock or MonotonicClock()
        self._link = CanLink(config.bus, self._clock, bus)
        self._axis = Axis(config, self._link, self._clock)
        self._parameters: Parameters | None = None
        self._ticks = 0
        quantities = frozenset({Quantity.TORQUE})
        self._gate = Gate(self._link.name, quantities, torque_off=self._torque_off, release=self._link.close)
        with self._gate.opening(lambda: self._axis.requests.tell([self._axis.codec.put("set_state", IDLE)])):
            firmware = self._axis.identify()
            self._parameters = self._open_parameters(firmware)
            self.disarm()
        self._info = ServoInfo(
            backend="odrive",
            model="ODrive v3" if self._axis.codec.layout == "0.5" else "ODrive",
            serial=f"node id {config.id}",
            firmware=firmware,
            quantities=quantities,
        )

    @property
    def info(self) -> ServoInfo:
        """What this servo is. Its counts depend on encoder and shunts, which CANSimple does not tell: NaN."""
        return self._info

    @property
    def clock(self) -> Clock:
        """The machine's monotonic time."""
        return self._clock

    def arm(self, limits: Limits) -> None:
        """Write the limits into the axis, then enter closed loop at zero torque.

        With `endpoints` torque, current, velocity and temperature limits and the watchdog are read back; without, speed
        and current limits are sent and CANSimple cannot read them. An error that only says that nobody fed the watchdog
        before we came is cleared. Raises DeviceFault where an error is latched, DriverError where a limit is refused or
        the axis does not enter closed loop; it is idle then.
        """
        with self._gate.arming(limits):
            self._clear_stale_watchdog()
            self._prepare(limits)
            self._enable()

    def exchange(self, command: Command) -> Sample:
        """Send the set-point and read position, velocity and torque.

        Raises UnsafeCommand, NoReply, BadReply, LinkLost, and DeviceFault where the axis says an error or is not in
        closed loop any more.
        """
        admitted = self._gate.admit(command)
        sign = self._config.sign
        torque = "torques" if self._axis.codec.knows("torques") else "iq"
        frames = [self._axis.codec.put("set_torque", sign * admitted.command.value)] if admitted.command else []
        frames += [self._axis.codec.request("encoder"), self._axis.codec.request(torque), *self._slow_request()]
        self._axis.requests.refuse_unasked()
        sent = self._clock.now()
        try:
            replies = self._axis.requests.ask(frames, ["encoder", torque])
        finally:
            self._check_state()
        received = self._clock.now()
        position, velocity = self._axis.codec.decoded("encoder", replies["encoder"])
        _, measured = self._axis.codec.decoded(torque, replies[torque])
        if not (math.isfinite(position) and math.isfinite(velocity) and math.isfinite(measured)):
            raise BadReply("the axis says that a reading is not a number: the sample is dropped")
        scale = 1.0 if torque == "torques" else self._config.torque_constant
        return Sample(
            t=sent,
            t_read=0.5 * (sent + received),
            motor_position=sign * position * _TURN,
            motor_velocity=sign * velocity * _TURN,
            motor_torque=sign * measured * scale,
            temperature=self._axis.temperature,
            voltage=self._axis.voltage,
            status=Status.SATURATED if admitted.clipped else Status(0),
        )

    def disarm(self) -> None:
        """Set zero torque and idle until a heartbeat confirms it. Harmless when already idle.

        Raises DriverError where the device does not confirm it; then cut the power.
        """
        self._gate.disarm()

    def close(self) -> None:
        """Idle, the parameters as they were found, then let go of the bus. Harmless when closed; never raises.

        Whoever has to know that the torque is off calls `disarm` first.
        """
        self._gate.close(self._parameters.restore if self._parameters else None)

    def _torque_off(self, _request: int) -> None:
        codec = self._axis.codec
        self._axis.requests.tell([codec.put("set_torque", 0.0), codec.put("set_state", IDLE)])
        self._axis.requests.listen()
        if not self._axis.requests.await_change(_STATE_CHANGE, partial(self._idle_since, self._axis.beats)):
            raise DriverError("no heartbeat says that it is idle")

    def _idle_since(self, beats: int) -> bool:
        return self._axis.beats > beats and self._axis.state == IDLE

    # -- opening ----------------------------------------------------------------------------------------------------

    def _open_parameters(self, firmware: str) -> Parameters | None:
        """The axis' parameters where the stand file says how they are numbered. Raises DriverError."""
        path = self._config.endpoints
        if path is None:
            return None
        if self._axis.codec.layout == "0.5":
            raise DriverError("odrive.endpoints: this axis has firmware 0.5, which has no parameters over CAN: drop it")
        parameters = Parameters(path, firmware, self._axis.requests, self._axis.codec)
        found = parameters.get("torque_constant")
        if abs(found - self._config.torque_constant) > 0.01 * self._config.torque_constant:
            raise DriverError(
                f"odrive.torque_constant is {self._config.torque_constant:g} N m/A in the stand file and {found:g} in "
                "the drive: correct the wrong one"
            )
        return parameters

    # -- arming -----------------------------------------------------------------------------------------------------

    def _clear_stale_watchdog(self) -> None:
        """Hear how the axis is; clear what only says that it was alone. Raises DeviceFault for anything else."""
        self._axis.hear_a_beat()
        bit = watchdog_bit(self._axis.codec.layout)
        if self._axis.errors == bit:
            self._axis.requests.tell([self._axis.codec.put("clear_errors")])
            self._axis.hear_a_beat()
            self._axis.errors &= ~bit  # 0.5.6 may have run out anew; entering closed loop feeds it
        if self._axis.errors:
            raise fault(self._axis.codec.layout, self._axis.errors)

    def _prepare(self, limits: Limits) -> None:
        current = limits.torque / self._config.torque_constant
        velocity = limits.velocity / _TURN
        self._axis.requests.tell(
            [
                self._axis.codec.put("set_torque", 0.0),
                self._axis.codec.put("set_mode", TORQUE_CONTROL, PASSTHROUGH),
                self._axis.codec.put("set_limits", velocity, current),
            ]
        )
        parameters = self._parameters
        if parameters is None:
            return
        self._check_clipping(parameters, limits.torque, velocity)
        for name, value in (
            ("velocity_limit", velocity),
            ("current_limit", current),
            ("torque_high", limits.torque),
            ("torque_low", -limits.torque),
            ("motor_temperature_limit", limits.temperature),
        ):
            parameters.require(name, value)
        if self._config.watchdog:
            parameters.require("watchdog_timeout", self._config.watchdog)
            parameters.require("enable_watchdog", 1.0)

    def _check_clipping(self, parameters: Parameters, torque: float, velocity: float) -> None:
        """Raise DriverError where the axis would clip the torque by its speed limit though it stands still."""
        allowed = parameters.get("velocity_gain") * velocity
        if parameters.get("torque_mode_velocity_limit") and torque > allowed:
            raise DriverError(
                f"the axis limits torque to vel_gain times vel_limit, {allowed:.3g} N m, where {torque:.3g} N m are "
                "wanted: raise limits.velocity, or set enable_torque_mode_vel_limit to False with odrivetool"
            )

    def _enable(self) -> None:
        self._axis.requests.listen()
        beats = self._axis.beats
        for _ in range(_TRIES):
            self._axis.requests.tell(
                [self._axis.codec.put("set_torque", 0.0), self._axis.codec.put("set_state", CLOSED_LOOP)]
            )
            end = self._clock.now() + _STATE_CHANGE
            while self._clock.now() < end:
                # a beat is waited for in pieces: the watchdog has to be fed meanwhile
                if self._axis.requests.await_change(
                    0.02, lambda: self._axis.beats > beats and self._axis.state == CLOSED_LOOP
                ):
                    return
                self._axis.requests.tell([self._axis.codec.put("set_torque", 0.0)])
            if self._axis.errors:
                raise fault(self._axis.codec.layout, self._axis.errors)
        raise DriverError(
            "the axis does not enter closed loop: calibrate motor and encoder with odrivetool, then try again"
        )

    # -- running ----------------------------------------------------------------------------------------------------

    def _slow_request(self) -> list[can.Message]:
        self._ticks += 1
        if self._ticks % _EVERY:
            return []
        names = [name for name in ("temperature", "error", "bus") if self._axis.codec.knows(name)]
        return [self._axis.codec.request(names[self._ticks // _EVERY % len(names)])]

    def _check_state(self) -> None:
        """Raise DeviceFault where the axis is not doing any more what it was armed for."""
        if self._gate.armed and (self._axis.errors or self._axis.state != CLOSED_LOOP):
            raise fault(self._axis.codec.layout, self._axis.errors)
