"""moteus controllers on CAN FD as a `drivers.servo.Servo`. Wiring and limits: docs/can.md.

A tick is one frame each way: the command with its torque limit and its watchdog time, and a reply with position,
velocity, torque, mode, fault, voltage, temperatures and the controller's milliseconds, all sampled at one moment.
Torque is commanded as the vendor recommends: in position mode without a position, with all gains scaled to zero and the
torque as feed-forward.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from drivers.canbus.link import BusConfig, CanLink
from drivers.clock import Clock
from drivers.gate import Admitted, DriveServo
from drivers.moteus.config import MoteusConfig
from drivers.moteus.controller import Controller
from drivers.moteus.frames import (
    FAULT,
    FLOAT,
    INT8,
    INT16,
    INT32,
    POSITION,
    STOPPED,
    TIMEOUT,
    Registers,
    fault,
    limiting,
    read,
    restarted,
    timed_out,
    write,
)
from drivers.servo import BadReply, Command, DriverError, Limits, Quantity, Sample, ServoInfo
from drivers.tick import WRAP, Freshness, TickClock

if TYPE_CHECKING:
    import can

    from drivers.neighbours import Neighbour
    from drivers.off_path import OffPath

_TRIES = 3
_PREPARATION = 20
"""Most commands to send until a controller that prepares its start must run."""
_FULL = 127  # of an int8 scale
_STATE = b"".join(
    [
        read("mode", INT8),
        read("position", FLOAT, 3),
        read("motor_temperature", INT16),
        read("voltage", INT16, 2),
        read("fault", INT8),
        read("milliseconds", INT32),
    ]
)
_STOP = write("mode", INT8, STOPPED)


class MoteusServo(DriveServo):
    """One controller that is open, identified and stopped.

    clock, bus: given by tests; None uses the real clock and opens the bus of `config`. In `info` the counts of position
    and torque are NaN, since the controller does not report them. Raises DriverError if the bus cannot be opened or the
    firmware lacks a register, NoReply if no controller replies, BadReply if several controllers reply.
    """

    def __init__(self, config: MoteusConfig, *, clock: Clock | None = None, bus: can.BusABC | None = None) -> None:
        super().__init__(config.sign, clock)
        self._config = config
        self._link = CanLink(BusConfig.of(config), self.clock, bus)
        self._controller = Controller(config, self._link, self.clock)
        self._settings = self._controller.settings
        self._milliseconds = TickClock()
        self._impossible = 0
        self._last_position = 0.0
        quantities = frozenset({config.quantity})
        self._gate = self._controller.requests.gate(quantities, self._torque_off, "moteus.mode")
        with self._gate.opening(lambda: self._controller.send(_STOP)):
            identity = self._controller.identify()
            state = self._controller.exchange(_STATE)
            self._gate.live = state["mode"] not in {STOPPED, FAULT}  # a stop would clear a fault that `arm` must report
            self.disarm()
        firmware = identity.whole("firmware")
        self.info = ServoInfo(
            backend="moteus",
            model=f"moteus, model number {identity.whole('model')}",
            serial="".join(
                f"{identity.whole(f'serial_{part}') & 0xFFFFFFFF:08x}" for part in ("high", "middle", "low")
            ),
            firmware=f"{firmware >> 16 & 0xFF}.{firmware >> 8 & 0xFF}.{firmware & 0xFF}",
            quantities=quantities,
            watchdog=config.watchdog,
        )

    def _arm(self, limits: Limits) -> None:
        """Write the limits into the controller and read them back, then start the controller at zero torque, or at its
        present position.

        The limits of speed and temperature are written to the configuration, and also that a tripped watchdog stops the
        motor (by default it holds the position). Torque limit and watchdog time are part of every command.
        """
        state = self._controller.exchange(_STATE)
        if state["mode"] == FAULT:
            raise fault(state.whole("fault"))
        self._stop()
        self._prepare(limits)
        self._milliseconds.restart()
        self._last_position = state["position"]
        self._start(limits)

    def _exchange(self, admitted: Admitted) -> Sample:
        """Send the set-point and read the state. In position mode the last position is sent again for
        `Command.rest()`.
        """
        subframes = self._subframes(admitted.command)
        sent = self.clock.now()
        state = self._controller.exchange(*subframes, _STATE)
        return self._checked(state, (sent, self.clock.now()), saturated=admitted.clipped)

    def neighbours(self) -> list[Neighbour]:
        """See `drivers.neighbours.HasNeighbours`."""
        return self._controller.neighbours()

    def off_path(self) -> OffPath:
        """Return the frames that switch the torque off, for another process to send."""
        return self._link.off_path([self._controller.unanswered(_STOP)], self._controller.restoring())

    def _torque_off(self, _request: int) -> None:
        self._controller.send(_STOP)  # before `_stop`, which waits for replies that are still due
        self._stop()

    def _stop(self) -> None:
        mode = self._controller.exchange(_STOP, read("mode", INT8))["mode"]
        if mode == POSITION:  # it may still obey a command of no torque
            self._controller.exchange(*self._commanded(math.nan, 0.0, 0, 0.0), read("mode", INT8))
        if mode != STOPPED:
            raise DriverError(f"it is in mode {mode:.0f} after a stop")

    def _prepare(self, limits: Limits) -> None:
        """Write the limits for which the controller has settings. No setting is raised; NaN in a setting means that it
        has no limit.
        """
        controller = self._controller
        for name, value in (
            ("servo.max_velocity", limits.velocity / math.tau),
            ("servo.fault_temperature", limits.temperature),
            ("servo.motor_fault_temperature", limits.temperature),
        ):
            present = controller.get(name)
            controller.settings.require(name, value if math.isnan(present) else min(present, value))
        controller.settings.require("servo.timeout_mode", STOPPED)

    def _start(self, limits: Limits) -> None:
        """Command zero torque, or the present position, until the controller runs. Raises DeviceFault, DriverError."""
        torque = self._config.quantity is Quantity.TORQUE
        command = self._torque(0.0, limits) if torque else self._position(self._last_position, limits)
        for _ in range(_PREPARATION):
            state = self._controller.exchange(*command, _STATE)
            if state["mode"] == FAULT:
                raise fault(state.whole("fault"))
            if state["mode"] == POSITION:
                return
            self.clock.sleep_until(self.clock.now() + 0.005)
        raise DriverError(f"the moteus does not start (mode {state['mode']:.0f}): check it with tview")

    def _torque(self, torque: float, limits: Limits) -> tuple[bytes, ...]:
        return self._commanded(math.nan, torque, 0, limits.torque)

    def _position(self, position: float, limits: Limits) -> tuple[bytes, ...]:
        return self._commanded(position, 0.0, _FULL, limits.torque)

    def _commanded(self, position: float, torque: float, gain: int, ceiling: float) -> tuple[bytes, ...]:
        """Return the subframes of a command.

        position: rev. torque: feed-forward, N m. gain: scale of all gains, 0 to 127. ceiling: torque limit, N m.
        """
        return (
            write("mode", INT8, POSITION),
            write("command_position", FLOAT, position, 0.0, torque),
            write("command_kp_scale", INT8, gain, gain),
            write("command_max_torque", FLOAT, ceiling),
            write("command_timeout", FLOAT, self._config.watchdog),
            write("command_ilimit_scale", INT8, gain),
        )

    def _subframes(self, command: Command | None) -> tuple[bytes, ...]:
        """Return the subframes to send for a command: none while disarmed; the last position again if `command` is
        None.
        """
        limits = self._gate.limits
        if limits is None:
            return ()
        if command is None:
            return self._position(self._last_position, limits)
        value = self._config.sign * command.value
        if command.quantity is Quantity.TORQUE:
            return self._torque(value, limits)
        self._last_position = value / math.tau
        return self._position(self._last_position, limits)

    def _checked(self, state: Registers, times: tuple[float, float], *, saturated: bool) -> Sample:
        missing = {"mode", "position", "velocity", "torque", "fault", "milliseconds"} - state.keys()
        if missing:
            raise BadReply(f"the reply lacks {', '.join(sorted(missing))}: the sample is dropped")
        self._check_mode(state)
        freshness = self._milliseconds.judge(state.whole("milliseconds") % WRAP, *times)
        if freshness is Freshness.IMPOSSIBLE:
            self._refuse_impossible()
        self._impossible = 0
        temperatures = [state.get(name, math.nan) for name in ("temperature", "motor_temperature")]
        return self._sample(
            times,
            state["position"] * math.tau,
            state["velocity"] * math.tau,
            state["torque"],
            temperature=max((value for value in temperatures if math.isfinite(value)), default=math.nan),
            voltage=state.get("voltage", math.nan),
            saturated=saturated or limiting(state.whole("fault")),
            stale=freshness is Freshness.STILL,
        )

    def _check_mode(self, state: Registers) -> None:
        """Raise DeviceFault if the controller has left the mode into which it was armed."""
        mode = state["mode"]
        if mode == FAULT:
            raise fault(state.whole("fault"))
        if not self._gate.armed or mode == POSITION:
            return
        # a restarted controller would start again with the next command: that must not look like running on
        raise timed_out(self._config.watchdog) if mode == TIMEOUT else restarted()

    def _refuse_impossible(self) -> None:
        """Raise the error for a sample that contradicts the controller's clock: BadReply, or DeviceFault after several
        such samples in a row.
        """
        self._impossible += 1
        if not self._gate.armed:
            self._milliseconds.restart()
        elif self._impossible == _TRIES:
            raise restarted()
        raise BadReply("the reply is older than its request, or the controller has restarted: the sample is dropped")
