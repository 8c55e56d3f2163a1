"""A motor on a SimpleFOC board that speaks Commander, behind `drivers.servo.Servo`. Wiring and limits: docs/serial.md.

A tick is one round trip of three lines: the target, `MMG7` for all that is measured, `ME` for whether the motor is
still enabled. Torque only: the current Iq is commanded and measured.
"""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING

from drivers.clock import Clock, MonotonicClock
from drivers.commander.lines import DECIMALS, RESOLUTION, State, number, same, state, target
from drivers.commander.link import CommanderLink, shown
from drivers.gate import Gate
from drivers.servo import (
    BadReply,
    Command,
    DeviceFault,
    DriverError,
    Limits,
    NoReply,
    Quantity,
    Sample,
    ServoInfo,
    Status,
)
from drivers.uart.port import GONE, Port, open_port

if TYPE_CHECKING:
    from drivers.commander.config import CommanderConfig

STOPPED = 1
"""Our code for a motor that the board has disabled by itself."""
RESTARTED = 2
"""Our code for a board that was restarted."""

_TRIES = 3
_WAKE = 0.25  # s between two calls to a board that may still be booting
_MACHINE, _AWAKE = "@3", "@machine"  # the verbose mode in which replies name their command
_MODES = {"dc_current": ("1", "dc curr"), "foc_current": ("2", "foc curr")}


class CommanderServo:
    """One motor, opened, identified, and disabled.

    clock and port are those of the machine unless a test brings its own. Raises DriverError where the port cannot be
    opened or the motor is not there, NoReply where nobody answers, BadReply where what answers is no Commander.
    """

    def __init__(self, config: CommanderConfig, *, clock: Clock | None = None, port: Port | None = None) -> None:
        self._config = config
        self._m = config.motor
        self.clock: Clock = clock or MonotonicClock()
        self._ceiling = 0.0
        self._count = 0
        self._doubt = False
        port = port or open_port(config.port, config.baudrate)
        self._link = CommanderLink(port, config.port, config.baudrate, self.clock, config.reply_timeout)
        quantities = frozenset({Quantity.TORQUE})
        self._gate = Gate(config.port, quantities, torque_off=self._torque_off, release=self._close_link)
        with self._gate.opening():
            self._wake()
            self._set_up()
        self.info = ServoInfo(backend="commander", model=f"SimpleFOC motor {self._m}", quantities=quantities)

    def arm(self, limits: Limits) -> None:
        """Set torque mode and limits, each read back, and enable the motor at a target of zero.

        The current limit is the torque limit; before library 2.4 it does not bound a target in torque mode, which is
        bounded here. The velocity limit acts in the board's velocity and angle modes only.
        Raises DriverError where something is refused; the motor is disabled then.
        """
        current = limits.torque / self._config.torque_constant
        if current < RESOLUTION:
            raise DriverError(f"torque limit {limits.torque:.3g} N m is {current:.3g} A, below what a target resolves")
        mode, said = _MODES[self._config.torque_mode]
        with self._gate.arming(limits):
            self._order("E0", "E", "0")  # first: a target means something else in every mode
            self._prepare()
            self._hush()
            self._order("C0", "C", "torque")
            self._order(f"T{mode}", "T", said)
            self._limit("LC", current, "current")
            self._limit("LV", limits.velocity, "velocity")
            self._link.exchange([f"{self._m}0"], self._is_zero, "the target of zero")
            self._order("E1", "E", "1")
        self._ceiling = current

    def exchange(self, command: Command) -> Sample:
        """Send the target and read the state in one round trip.

        Raises UnsafeCommand, NoReply, BadReply, LinkLost, and DeviceFault where the board was restarted or has disabled
        the motor by itself.
        """
        admitted = self._gate.admit(command)
        text = None if admitted.command is None else self._target(admitted.command.value)
        if self._doubt and self._gate.armed:
            self._raise_restarted()
        self._doubt = True  # until the reply has come
        sent = self.clock.now()
        read = [f"{self._m}MG7", f"{self._m}E"]
        reply, enabled = self._read(read if text is None else [f"{self._m}{text}", *read], text)
        received = self.clock.now()
        self._doubt = False
        self._judge(enabled)
        sign, constant = self._config.sign, self._config.torque_constant
        # a disabled motor's current is not measured any more, and the last is repeated: no current flows
        current = reply.current if self._gate.armed else 0.0
        return Sample(
            t=sent,
            t_read=0.5 * (sent + received),
            motor_position=sign * reply.angle,
            motor_velocity=sign * reply.velocity,
            motor_torque=sign * current * constant,
            status=Status.SATURATED if admitted.clipped else Status(0),
        )

    def disarm(self) -> None:
        """Disable the motor and set its target to zero. Harmless when already off.

        Raises DriverError where the device does not confirm it; then cut the power.
        """
        self._gate.disarm()

    def close(self) -> None:
        """Disable the motor, then let go of the port. Harmless when closed; never raises.

        Whoever has to know that the torque is off calls `disarm` first.
        """
        self._gate.close()

    def _torque_off(self, _request: int) -> None:
        try:
            self._link.send(f"{self._m}E0", f"{self._m}0", f"{self._m}E0", f"{self._m}MC", _MACHINE)
            if self._link.ask(f"{self._m}E", f"{self._m}E") != "0":
                raise DriverError("it is still on")
        finally:
            self._link.quarantine()  # more replies are due than were waited for

    def _close_link(self) -> None:
        with contextlib.suppress(*GONE):
            self._link.close()

    def _wake(self) -> None:
        """Call until the board answers; the torque is off from the first call that it hears."""
        config, m = self._config, self._m
        deadline = self.clock.now() + config.start
        heard: list[str] = []
        calls = 0
        while _AWAKE not in heard:
            if self.clock.now() >= deadline:
                self._say_who(heard)
            self._link.send(f"{m}E0", f"{m}0", f"{m}MC", _MACHINE)  # MC: what streams would never let us be heard
            heard = [*heard[-20:], *self._link.listen(_WAKE, _AWAKE)]
            calls += 1
        if calls > 1:
            self._link.listen(_WAKE)  # a board that was booting answers all that it was called

    def _say_who(self, heard: list[str]) -> None:
        """Raise for a board that did not answer as a Commander does."""
        config = self._config
        where = f"{config.port} at {config.baudrate} baud"
        if not heard:
            raise NoReply(
                f"nothing answers on {where}: check the board's power and cable, commander.baudrate, and that its "
                "program calls commander.run() in its loop"
            )
        raise BadReply(
            f"what answers on {where} is no Commander of SimpleFOC 2.2 or later ({shown(heard[-1])}): check "
            "commander.port, the baud rate, and the library's version"
        )

    def _set_up(self) -> None:
        """See that the motor is there, and off."""
        config, m = self._config, self._m
        self._prepare()
        try:
            self._hush()
        except (NoReply, BadReply):
            self._link.send("?")
            letters = [line[1:] for line in self._link.listen(_WAKE) if line.startswith("?")]
            raise DriverError(
                f"the board on {config.port} has no motor {m!r} that can be read: it has "
                f"{', '.join(letters) or 'none'}; correct commander.motor, or let the program add it with "
                "commander.motor(&motor, cmd)"
            ) from None
        self.disarm()

    def _prepare(self) -> None:
        """Make the board print as it is read here."""
        self._stubborn(_MACHINE, "@", "machine")
        self._stubborn(f"#{DECIMALS}", "#", str(DECIMALS))

    def _hush(self) -> None:
        """Make the motor print nothing by itself; only a motor that was added whole can."""
        self._stubborn(f"{self._m}MC", f"{self._m}MC", "clear")

    def _stubborn(self, command: str, head: str, wanted: str) -> None:
        """Ask up to three times for what `wanted` confirms. Raises DriverError."""
        trouble: DriverError = BadReply(f"{command} is not confirmed")
        for _ in range(_TRIES):
            try:
                if self._link.ask(command, head) == wanted:
                    return
            except (NoReply, BadReply) as error:
                trouble = error
        raise trouble

    def _order(self, command: str, head: str, wanted: str) -> None:
        """Set something of the motor. Raises DriverError where the board does not say that it did."""
        told = self._link.ask(f"{self._m}{command}", f"{self._m}{head}")
        if told != wanted:
            raise DriverError(f"{self._m}{command} was answered with {told!r} instead of {wanted!r}: it was refused")

    def _limit(self, command: str, value: float, name: str) -> None:
        """Set a limit, rounded down, and read it back. Raises DriverError where the board has another."""
        text = f"{math.floor(value * 1e5) / 1e5:.5f}"
        told = number(self._link.ask(f"{self._m}{command}{text}", f"{self._m}{command}"))
        if told is None or abs(told - float(text)) > 1e-4 * value:
            raise DriverError(f"the board took {told} for its {name} limit of {text}: it was refused")

    def _is_zero(self, line: str) -> bool | None:
        told = number(line[len(self._m) :]) if line.startswith(self._m) else None
        return True if told == 0.0 else None

    def _target(self, torque: float) -> str:
        """Return the target of `torque` N m as it is sent."""
        self._count += 1
        current = self._config.sign * torque / self._config.torque_constant
        ceiling = self._ceiling - RESOLUTION  # the digit that is no current stays below the limit too
        return target(max(-ceiling, min(ceiling, current)), self._count)

    def _read(self, commands: list[str], sent: str | None) -> tuple[State, str]:
        """The state with the target `sent` (None: any), and the line behind it: whether the motor is enabled."""
        head, enabled = f"{self._m}MG", f"{self._m}E"
        found: State | None = None
        misheard = False

        def both(line: str) -> tuple[State, str] | None:
            nonlocal found, misheard
            if line.startswith(head):
                found = state(line[len(head) :])
                if found is not None and sent is not None and not same(sent, found.target):
                    found = None
                    if not misheard:  # a digit lost on the way may be ten times the current: not until the next tick
                        self._link.send(f"{self._m}{sent}")
                    misheard = True
            elif found is not None and line in {enabled + "0", enabled + "1"}:
                return found, line[len(enabled) :]
            return None

        return self._link.exchange(commands, both, "the state")

    def _judge(self, enabled: str) -> None:
        """Raise DeviceFault where an armed motor is off; switch a motor off that is on and should not be."""
        if not self._gate.armed:
            if enabled == "1":
                self._gate.force_off()
            return
        if enabled == "0":
            raise DeviceFault(
                STOPPED,
                "the board has disabled the motor by itself: its program's watchdog heard nothing for too long, or it "
                "found a fault; look for what held the computer or the link up, and at the board's program",
            )

    def _raise_restarted(self) -> None:
        """Raise DeviceFault where the board prints as it does after a start."""
        try:
            if self._link.ask("@", "@") == "machine":
                return
        except BadReply as error:
            if "Verb:" not in str(error):
                raise
        raise DeviceFault(
            RESTARTED,
            "the board was restarted, and its motor may be enabled: check its supply and its plug, and open it anew",
        )
