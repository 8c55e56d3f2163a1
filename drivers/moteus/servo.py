"""moteus controllers on CAN FD, behind `drivers.servo.Servo`. Wiring and limits: docs/can.md.

A tick is one frame each way: the command with its torque limit and its watchdog out, position, velocity, torque, mode,
fault, voltage, temperatures and the controller's milliseconds back, all of one moment. Torque mode is the vendor's:
position mode without a position, every gain scaled to zero, and the torque fed forward.
"""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING

from drivers.canbus.link import CanLink
from drivers.dynamixel.tick import WRAP, Freshness, TickClock
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
    fault,
    limiting,
    read,
    restarted,
    timed_out,
    write,
)
from drivers.servo import (
    BadReply,
    Clock,
    Command,
    DriverError,
    Limits,
    LinkLost,
    MonotonicClock,
    Quantity,
    Sample,
    ServoInfo,
    Status,
    UnsafeCommand,
)

if TYPE_CHECKING:
    import can

_TURN = 2.0 * math.pi
_TRIES = 3
_PREPARATION = 20
"""Commands that a controller may take to get ready."""
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


class MoteusServo:
    """One controller, opened, identified, and stopped.

    clock and bus are those of the machine unless a test brings its own. Raises DriverError where the bus cannot be
    opened or the firmware lacks a register, NoReply where nobody answers, BadReply where several do.
    """

    def __init__(self, config: MoteusConfig, *, clock: Clock | None = None, bus: can.BusABC | None = None) -> None:
        self._config = config
        self._clock = clock or MonotonicClock()
        self._link = CanLink(config.bus, self._clock, bus)
        self._controller = Controller(config, self._link, self._clock)
        self._milliseconds = TickClock()
        self._impossible = 0
        self._limits: Limits | None = None
        self._held = 0.0
        self._live = False
        self._closed = False
        try:
            found = self._controller.identify()
            state = self._controller.exchange(_STATE)
            self._live = state["mode"] not in {STOPPED, FAULT}  # a stop clears a fault, which arming is to tell of
            self.disarm()
        except BaseException:
            self._closed = True
            with contextlib.suppress(DriverError):  # whatever it is, it must not go on for another program
                self._controller.send(_STOP)
            self._link.close()
            raise
        firmware = int(found["firmware"])
        self._info = ServoInfo(
            backend="moteus",
            model=f"moteus, model number {int(found['model'])}",
            serial="".join(f"{int(found[f'serial_{part}']) & 0xFFFFFFFF:08x}" for part in ("high", "middle", "low")),
            firmware=f"{firmware >> 16 & 0xFF}.{firmware >> 8 & 0xFF}.{firmware & 0xFF}",
            quantities=frozenset({config.quantity}),
        )

    @property
    def info(self) -> ServoInfo:
        """What this servo is. Values come as floats; what its encoder and shunts resolve it does not tell: NaN."""
        return self._info

    @property
    def clock(self) -> Clock:
        """The machine's monotonic time."""
        return self._clock

    def arm(self, limits: Limits) -> None:
        """Write the limits into the controller and read them back, then let it run: at no torque, or where it is.

        Speed and temperature go into its configuration, together with a watchdog that stops (delivered, it holds);
        torque and watchdog time go along with every command. Raises DeviceFault where it is in fault, DriverError where
        a limit is refused or it does not start; it is stopped then.
        """
        self._open()
        try:
            state = self._controller.exchange(_STATE)
            if state["mode"] == FAULT:
                raise fault(int(state["fault"]))
            self._stop()
            self._prepare(limits)
            self._held = state["position"]
            self._start(limits)
        except BaseException:
            with contextlib.suppress(DriverError):
                self._live = True
                self.disarm()
            raise
        self._limits = limits

    def exchange(self, command: Command) -> Sample:
        """Send the set-point and read the state in one round trip.

        `Command.rest()` in position mode holds where it was told to be. Raises UnsafeCommand, NoReply, BadReply,
        LinkLost, and DeviceFault where the controller is in fault, timed out, or restarted.
        """
        subframes, saturated = self._set_point(command)
        self._open()
        sent = self._clock.now()
        state = self._controller.exchange(*subframes, _STATE)
        received = self._clock.now()
        return self._sample(state, sent, received, saturated=saturated)

    def disarm(self) -> None:
        """Stop, sent up to three times until the controller says so. Harmless when already stopped.

        Raises DriverError where it does not confirm it; then cut the power.
        """
        self._limits = None
        if not self._live or self._closed:
            return
        trouble: DriverError = DriverError("it goes on")
        for _ in range(_TRIES):
            try:
                self._controller.send(_STOP)  # first of all: a question would wait for what is still owed
                self._stop()
                self._live = False
                return
            except DriverError as error:
                trouble = error
        kind = LinkLost if isinstance(trouble, LinkLost) else DriverError
        raise kind(f"torque-off is not confirmed ({trouble}): cut the controller's power")

    def close(self) -> None:
        """Stop, the configuration as it was found, then let go of the bus. Harmless when closed; never raises.

        Whoever has to know that the torque is off calls `disarm` first.
        """
        if self._closed:
            return
        try:
            with contextlib.suppress(DriverError):
                self.disarm()
            self._controller.restore()
        finally:
            self._closed = True
            self._link.close()

    def _open(self) -> None:
        if self._closed:
            raise LinkLost(f"{self._link.name} is closed")

    def _stop(self) -> None:
        mode = self._controller.exchange(_STOP, read("mode", INT8))["mode"]
        if mode != STOPPED:
            raise DriverError(f"it is in mode {mode:.0f} after a stop")

    def _prepare(self, limits: Limits) -> None:
        """What the controller takes of the limits; none is ever raised. NaN means no limit there."""
        controller = self._controller
        for name, value in (
            ("servo.max_velocity", limits.velocity / _TURN),
            ("servo.fault_temperature", limits.temperature),
            ("servo.motor_fault_temperature", limits.temperature),
        ):
            found = controller.get(name)
            controller.require(name, value if math.isnan(found) else min(found, value))
        controller.require("servo.timeout_mode", STOPPED)

    def _start(self, limits: Limits) -> None:
        """Command no torque, or the position it has, until it runs."""
        self._live = True
        torque = self._config.quantity is Quantity.TORQUE
        command = self._torque(0.0, limits) if torque else self._position(self._held, limits)
        for _ in range(_PREPARATION):
            state = self._controller.exchange(*command, _STATE)
            if state["mode"] == FAULT:
                raise fault(int(state["fault"]))
            if state["mode"] == POSITION:
                return
            self._clock.sleep_until(self._clock.now() + 0.005)
        raise DriverError(f"the moteus does not start (mode {state['mode']:.0f}): check it with tview")

    def _torque(self, torque: float, limits: Limits) -> tuple[bytes, ...]:
        return self._commanded(math.nan, torque, 0, limits)

    def _position(self, position: float, limits: Limits) -> tuple[bytes, ...]:
        return self._commanded(position, 0.0, _FULL, limits)

    def _commanded(self, position: float, torque: float, gain: int, limits: Limits) -> tuple[bytes, ...]:
        """position rev, torque N m; gain: of all gains, 0 to 127."""
        return (
            write("mode", INT8, POSITION),
            write("command_position", FLOAT, position, 0.0, torque),
            write("command_kp_scale", INT8, gain, gain),
            write("command_max_torque", FLOAT, limits.torque),
            write("command_timeout", FLOAT, self._config.watchdog),
            write("command_ilimit_scale", INT8, gain),
        )

    def _set_point(self, command: Command) -> tuple[tuple[bytes, ...], bool]:
        """The subframes to send, none where nothing is driven; and whether the set-point was clipped."""
        if not math.isfinite(command.value):
            raise UnsafeCommand(f"set-point {command.value} is not a number: nothing was sent")
        at_rest = command == Command.rest()
        limits = self._limits
        if limits is None:
            if not at_rest:
                raise UnsafeCommand(f"{command.quantity} set-point {command.value} while disarmed: arm first")
            return (), False
        if command.quantity not in self._info.quantities:
            if at_rest:
                return self._position(self._held, limits), False
            raise UnsafeCommand(
                f"a {command.quantity} set-point in mode {self._config.quantity.value!r}: set moteus.mode otherwise"
            )
        bounded = limits.bound(command)
        value = self._config.sign * bounded.value
        if command.quantity is Quantity.TORQUE:
            return self._torque(value, limits), bounded != command
        self._held = value / _TURN
        return self._position(self._held, limits), bounded != command

    def _sample(self, state: dict[str, float], sent: float, received: float, *, saturated: bool) -> Sample:
        missing = {"mode", "position", "velocity", "torque", "fault", "milliseconds"} - state.keys()
        if missing:
            raise BadReply(f"the reply lacks {', '.join(sorted(missing))}: the sample is dropped")
        self._check_mode(state)
        freshness = self._milliseconds.judge(int(state["milliseconds"]) % WRAP, sent, received)
        if freshness is Freshness.IMPOSSIBLE:
            self._refuse_impossible()
        self._impossible = 0
        if not all(math.isfinite(state[name]) for name in ("position", "velocity", "torque")):
            raise BadReply("the controller says that a reading is not a number: the sample is dropped")
        status = Status.SATURATED if saturated or limiting(int(state["fault"])) else Status(0)
        if freshness is Freshness.STILL:
            status |= Status.STALE
        sign = self._config.sign
        temperatures = [state.get(name, math.nan) for name in ("temperature", "motor_temperature")]
        return Sample(
            t=sent,
            t_read=0.5 * (sent + received),
            motor_position=sign * state["position"] * _TURN,
            motor_velocity=sign * state["velocity"] * _TURN,
            motor_torque=sign * state["torque"],
            temperature=max((value for value in temperatures if math.isfinite(value)), default=math.nan),
            voltage=state.get("voltage", math.nan),
            status=status,
        )

    def _check_mode(self, state: dict[str, float]) -> None:
        """Raise DeviceFault where the controller is not doing any more what it was armed for."""
        mode = state["mode"]
        if mode == FAULT:
            raise fault(int(state["fault"]))
        if self._limits is None or mode == POSITION:
            return
        # a controller that was restarted begins anew with the next command: that must not pass for running on
        raise timed_out(self._config.watchdog) if mode == TIMEOUT else restarted()

    def _refuse_impossible(self) -> None:
        """Milliseconds that cannot be: an old reply; several in a row are a controller that was restarted."""
        self._impossible += 1
        if self._limits is None:
            self._milliseconds.restart()
        elif self._impossible == _TRIES:
            raise restarted()
        raise BadReply("the reply is older than its request, or the controller was restarted: the sample is dropped")
