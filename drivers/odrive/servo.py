"""ODrive on CANSimple as a `drivers.servo.Servo`. Wiring and limits: docs/can.md.

In each tick the computer sends the set-point (`Set_Input_Torque`), then two remote frames that request the encoder's
estimates and the torque. Every eighth tick also requests temperature, voltage or errors, and does not wait for the
reply. Cyclic messages, above all the heartbeat, are processed together with the replies.

Firmware 0.6 reports the torque (`Get_Torques`). Firmware 0.5.6 reports the current, which `torque_constant` converts to
torque.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

from drivers.canbus.link import BusConfig, CanLink
from drivers.clock import Clock, no_later
from drivers.gate import Admitted, DriveServo
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
from drivers.servo import DriverError, Limits, Quantity, Sample, ServoInfo

if TYPE_CHECKING:
    import can

    from drivers.neighbours import Neighbour
    from drivers.off_path import OffPath

_AGAIN = 0.35
"""s after which torque-off is requested again while the heartbeat that confirms it is awaited."""
_TRIES = 3
_EVERY = 8
"""Ticks between two requests for a slowly changing value."""


class OdriveServo(DriveServo):
    """One axis that is open, identified and idle.

    clock, bus: given by tests; None uses the real clock and opens the bus of `config`. In `info` the counts of position
    and torque are NaN, since CANSimple does not report them. Raises DriverError if the bus cannot be opened or the
    firmware is unknown, NoReply if no axis replies, BadReply if several axes reply.
    """

    def __init__(self, config: OdriveConfig, *, clock: Clock | None = None, bus: can.BusABC | None = None) -> None:
        super().__init__(config.sign, clock)
        self._config = config
        self._link = CanLink(BusConfig.of(config), self.clock, bus)
        self._axis = Axis(config, self._link, self.clock)
        self._parameters: Parameters | None = None
        self._ticks = 0
        quantities = frozenset({Quantity.TORQUE})
        self._gate = self._axis.requests.gate(quantities, self._torque_off)
        with self._gate.opening(lambda: self._axis.requests.send([self._axis.codec.put("set_state", IDLE)])):
            firmware = self._axis.identify()
            self._parameters = self._open_parameters(firmware)
            self._settings = self._parameters.settings if self._parameters else None
            self.disarm()
        self.info = ServoInfo(
            backend="odrive",
            model="ODrive v3" if self._axis.codec.layout == "0.5" else "ODrive",
            serial=f"node id {config.id}",
            serial_is_id=True,
            firmware=firmware,
            quantities=quantities,
            watchdog=config.watchdog if self._parameters is not None else 0.0,
            watchdog_remedy=""
            if self._axis.codec.layout == "0.5"
            else "set odrive.watchdog = 0.1 and odrive.endpoints to the flat_endpoints.json of its firmware",
        )

    def _arm(self, limits: Limits) -> None:
        """Write the limits into the axis, then enter closed loop at zero torque.

        With `endpoints`, the watchdog and the limits of torque, current, velocity and temperature are read back.
        Without, only the limits of velocity and current are sent, and CANSimple cannot read them back. An old watchdog
        error is cleared.
        """
        self._clear_stale_watchdog()
        self._prepare(limits)
        self._enable()

    def _exchange(self, admitted: Admitted) -> Sample:
        """Send the set-point and read position, velocity and torque."""
        torque = "torques" if self._axis.codec.has("torques") else "iq"
        frames = [self._axis.codec.put("set_torque", self._sign * admitted.command.value)] if admitted.command else []
        frames += [self._axis.codec.request("encoder"), self._axis.codec.request(torque), *self._slow_request()]
        self._axis.requests.refuse_unrequested()
        sent = self.clock.now()
        try:
            replies = self._axis.requests.ask(frames, ["encoder", torque])
        finally:
            self._check_state()
        received = self.clock.now()
        position, velocity = self._axis.codec.decoded("encoder", replies["encoder"])
        _, measured = self._axis.codec.decoded(torque, replies[torque])
        return self._sample(
            (sent, received),
            position * math.tau,
            velocity * math.tau,
            measured * (1.0 if torque == "torques" else self._config.torque_constant),
            temperature=self._axis.temperature,
            voltage=self._axis.voltage,
            saturated=admitted.clipped,
        )

    def neighbours(self) -> list[Neighbour]:
        """See `drivers.neighbours.HasNeighbours`."""
        return self._axis.neighbours()

    def off_path(self) -> OffPath:
        """Return the frames that switch the torque off, for another process to send."""
        return self._link.off_path(self._off(), self._parameters.restoring() if self._parameters else ())

    def _off(self) -> list[can.Message]:
        return [self._axis.codec.put("set_torque", 0.0), self._axis.codec.put("set_state", IDLE)]

    def _torque_off(self, _request: int) -> None:
        self._axis.requests.send(self._off())
        self._axis.requests.process()
        idle = partial(self._idle_since, self._axis.beats)
        end = no_later(self.clock.now() + self._axis.patience)
        while not self._axis.requests.wait_until(min(_AGAIN, end - self.clock.now()), idle):
            if self.clock.now() >= end:
                raise DriverError("no heartbeat reports idle")
            self._axis.requests.send(self._off())

    def _idle_since(self, beats: int) -> bool:
        return self._axis.beats > beats and self._axis.state == IDLE

    # -- opening ----------------------------------------------------------------------------------------------------

    def _open_parameters(self, firmware: str) -> Parameters | None:
        """Return the parameters of the axis if the stand file names the endpoint file, else None. Raises
        DriverError.
        """
        path = self._config.endpoints
        if path is None:
            return None
        if self._axis.codec.layout == "0.5":
            raise DriverError(
                "odrive.endpoints: this axis has firmware 0.5, which has no parameters over CAN: remove it"
            )
        parameters = Parameters(path, firmware, self._axis.requests, self._axis.codec)
        reported = parameters.get("torque_constant")
        if abs(reported - self._config.torque_constant) > 0.01 * self._config.torque_constant:
            raise DriverError(
                f"odrive.torque_constant is {self._config.torque_constant:g} N m/A in the stand file and {reported:g} "
                "in the drive: correct the wrong one"
            )
        return parameters

    # -- arming -----------------------------------------------------------------------------------------------------

    def _clear_stale_watchdog(self) -> None:
        """Clear a watchdog error that is latched from an earlier run. Raises DeviceFault for any other error."""
        self._axis.await_heartbeat()
        bit = watchdog_bit(self._axis.codec.layout)
        if self._axis.errors == bit:
            self._axis.requests.send([self._axis.codec.put("clear_errors")])
            self._axis.await_heartbeat()
            self._axis.errors &= ~bit  # of 0.5.6 may have tripped again; entering closed loop feeds it
        if self._axis.errors:
            raise fault(self._axis.codec.layout, self._axis.errors)

    def _prepare(self, limits: Limits) -> None:
        current = limits.torque / self._config.torque_constant
        velocity = limits.velocity / math.tau
        codec, parameters = self._axis.codec, self._parameters
        self._axis.requests.send([codec.put("set_torque", 0.0), codec.put("set_mode", TORQUE_CONTROL, PASSTHROUGH)])
        if parameters is None:  # otherwise the limits are parameters, which are restored
            self._axis.requests.send([codec.put("set_limits", velocity, current)])
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
        """Raise DriverError if the axis' velocity limit would limit the torque even at standstill, because the axis
        clips in torque mode.

        torque: N m, the torque limit. velocity: rev/s, the velocity limit.
        """
        allowed = parameters.get("velocity_gain") * velocity
        if parameters.get("torque_mode_velocity_limit") and torque > allowed:
            raise DriverError(
                f"the axis limits torque to vel_gain times vel_limit, {allowed:.3g} N m, below the limit of "
                f"{torque:.3g} N m: raise limits.velocity, or set enable_torque_mode_vel_limit to False with odrivetool"
            )

    def _enable(self) -> None:
        self._axis.requests.process()
        beats = self._axis.beats
        for _ in range(_TRIES):
            self._axis.requests.send(
                [self._axis.codec.put("set_torque", 0.0), self._axis.codec.put("set_state", CLOSED_LOOP)]
            )
            end = self.clock.now() + self._axis.patience
            while self.clock.now() < end:
                # in short waits, since the watchdog must be fed meanwhile
                if self._axis.requests.wait_until(
                    0.02, lambda: self._axis.beats > beats and self._axis.state == CLOSED_LOOP
                ):
                    return
                self._axis.requests.send([self._axis.codec.put("set_torque", 0.0)])
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
        names = [name for name in ("temperature", "error", "bus") if self._axis.codec.has(name)]
        return [self._axis.codec.request(names[self._ticks // _EVERY % len(names)])]

    def _check_state(self) -> None:
        """Raise DeviceFault if an armed axis reports an error or has left closed loop."""
        if self._gate.armed and (self._axis.errors or self._axis.state != CLOSED_LOOP):
            raise fault(self._axis.codec.layout, self._axis.errors)
