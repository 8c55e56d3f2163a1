"""A motor on a SimpleFOC board with Commander as a `drivers.servo.Servo`. Wiring and limits: docs/serial.md.

A tick is one round trip of three lines: the target, `MMG7` for all measurements, and `ME` for whether the motor is
still enabled. Only torque is commanded, as the current Iq, which the board also measures.
"""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING

from drivers.clock import Clock
from drivers.commander.lines import DECIMALS, RESOLUTION, CommanderState, number, same, state, target
from drivers.commander.link import CommanderLink, shown
from drivers.gate import Admitted, DriveServo, Gate
from drivers.off_path import OffPath
from drivers.retry import retry
from drivers.servo import BadReply, DeviceFault, DriverError, Limits, NoReply, Quantity, Sample, ServoInfo
from drivers.torque_constant import check_current
from drivers.uart.port import GONE, OpenPort, open_port

if TYPE_CHECKING:
    from drivers.commander.config import CommanderConfig

STOPPED = 1
"""Fault code of this project: the board has disabled the motor by itself."""
RESTARTED = 2
"""Fault code of this project: the board has restarted."""

_WAKE = 0.25  # s between two requests to a board that may still be booting
_MACHINE, _AWAKE = "@3", "@machine"  # the verbose mode in which replies name their command
_STARTED = "Verb:"  # begins the reply in the verbose mode of a start
_MODES = {"dc_current": ("1", "dc curr"), "foc_current": ("2", "foc curr")}


class CommanderServo(DriveServo):
    """One motor that is open, identified and disabled.

    clock, port: given by tests; None uses the real clock and opens the port of `config`. In `info` the counts and the
    firmware version are not known, since the board does not report them. Raises DriverError if the port cannot be
    opened or the board lacks the motor, NoReply if no board replies, BadReply if the replies are not Commander's.
    """

    def __init__(self, config: CommanderConfig, *, clock: Clock | None = None, port: OpenPort | None = None) -> None:
        super().__init__(config.sign, clock)
        self._config = config
        self._m = config.motor
        self._ceiling = 0.0
        self._count = 0
        self._unsure = False
        port = port or open_port(config.port, config.baudrate)
        self._link = CommanderLink(port, config.port, config.baudrate, self.clock, config.reply_timeout)
        quantities = frozenset({Quantity.TORQUE})
        self._gate = Gate(
            config.port,
            quantities,
            torque_off=self._torque_off,
            release=self._close_link,
            clock=self.clock,
            repeats=self._link.repeats,
        )
        with self._gate.opening():
            self._wake()
            self._set_up()
        self.info = ServoInfo(
            backend="commander",
            model=f"SimpleFOC motor {self._m}",
            quantities=quantities,
            measures_when_off=False,
            watchdog=config.watchdog,
            watchdog_remedy="put a watchdog into the board's program (docs/serial.md) and its time into "
            "commander.watchdog",
        )

    def _arm(self, limits: Limits) -> None:
        """Set torque mode and limits and read them back, then enable the motor at a target of zero.

        The current limit is the torque limit. Before library 2.4 the board does not apply the current limit to a target
        in torque mode, so the target is clamped here. The board applies the velocity limit only in its velocity and
        angle modes.
        """
        current = limits.torque / self._config.torque_constant
        if current < RESOLUTION:
            raise DriverError(
                f"torque limit {limits.torque:.3g} N m is {current:.3g} A, below the resolution of a target: raise it"
            )
        mode, confirmed = _MODES[self._config.torque_mode]
        self._set("E0", "E", "0")  # first: a target means something else in every mode
        self._prepare()
        self._stop_printing()
        own = number(self._link.ask(f"{self._m}LC", f"{self._m}LC"))
        if own:
            key = "commander.torque_constant"
            check_current(key, self._config.torque_constant, limits.torque, own, f"{self._m}LC of the board")
        self._set("C0", "C", "torque")
        self._set(f"T{mode}", "T", confirmed)
        self._limit("LC", current, "current")
        self._limit("LV", limits.velocity, "velocity")
        self._link.exchange([f"{self._m}0"], self._is_zero, "the target of zero")
        self._set("E1", "E", "1")
        self._ceiling = current

    def _exchange(self, admitted: Admitted) -> Sample:
        """Send the target and read the state."""
        text = None if admitted.command is None else self._target(admitted.command.value)
        if self._unsure and self._gate.armed:
            self._raise_restarted()
        self._unsure = True  # whether the board has restarted, until the reply arrives
        sent = self.clock.now()
        read = [f"{self._m}MG7", f"{self._m}E"]
        reply, enabled = self._read(read if text is None else [f"{self._m}{text}", *read], text)
        received = self.clock.now()
        self._unsure = False
        self._check_enabled(enabled)
        # of a disabled motor the board repeats the last current; none flows, unless its word is not to be trusted yet
        current = reply.current if enabled == "1" else None if self._gate.live else 0.0
        torque = None if current is None else current * self._config.torque_constant
        return self._sample((sent, received), reply.angle, reply.velocity, torque, saturated=admitted.clipped)

    def off_path(self) -> OffPath:
        """Return the lines that switch the torque off, for another process to send.

        No settings are restored, since the board stores nothing that a run changes.
        """
        return self._link.off_path([f"{self._m}E0", f"{self._m}0", f"{self._m}E0"])

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
        """Send torque-off until the board replies. The board switches the torque off at the first request that it
        receives.
        """
        config, m = self._config, self._m
        deadline = self.clock.now() + config.start
        lines: list[str] = []
        requests = 0
        while _AWAKE not in lines:
            if self.clock.now() >= deadline:
                self._raise_silent(lines)
            self._link.send(f"{m}E0", f"{m}0", f"{m}MC", _MACHINE)  # MC: a stream of lines would hide the reply
            lines = [*lines[-20:], *self._link.listen(_WAKE, _AWAKE)]
            requests += 1
        self._link.echoes = _MACHINE in lines
        if requests > 1:
            self._link.listen(_WAKE)  # a board that was booting replies to every request

    def _raise_silent(self, lines: list[str]) -> None:
        """Raise NoReply or BadReply for a board that did not reply as Commander does. lines: the lines that arrived."""
        config = self._config
        where = f"{config.port} at {config.baudrate} baud"
        if not lines:
            raise NoReply(
                f"nothing answers on {where}: check the board's power and cable, commander.baudrate, and that its "
                "program calls commander.run() in its loop"
            )
        raise BadReply(
            f"the board on {where} is no Commander of SimpleFOC 2.2 or later ({shown(lines[-1])}): check "
            "commander.port, the baud rate, and the library's version"
        )

    def _set_up(self) -> None:
        """Check that the board has the motor, and switch its torque off."""
        config, m = self._config, self._m
        self._prepare()
        try:
            self._stop_printing()
        except (NoReply, BadReply):
            self._link.send("?")
            letters = [line[1:] for line in self._link.listen(_WAKE) if line.startswith("?")]
            raise DriverError(
                f"the board on {config.port} has no motor {m!r} that can be read: it has "
                f"{', '.join(letters) or 'none'}; correct commander.motor, or add it in the program with "
                "commander.motor(&motor, cmd)"
            ) from None
        self.disarm()

    def _prepare(self) -> None:
        """Set the format in which the board prints."""
        self._confirm(_MACHINE, "@", "machine")
        self._confirm(f"#{DECIMALS}", "#", str(DECIMALS))

    def _stop_printing(self) -> None:
        """Stop the motor's cyclic output. Only a motor that the program added with `commander.motor` has this
        output.
        """
        self._confirm(f"{self._m}MC", f"{self._m}MC", "clear")

    def _confirm(self, command: str, head: str, wanted: str) -> None:
        """Send a command up to three times, until its reply, without the leading `head`, is `wanted`. Raises NoReply,
        BadReply, LinkLost.
        """

        def request() -> None:
            if self._link.ask(command, head) != wanted:
                raise BadReply(f"{command} is not confirmed")

        retry(request)

    def _set(self, command: str, head: str, wanted: str) -> None:
        """Change a setting of the motor. head: start of the reply. wanted: the value to read back. Raises DriverError
        if the board does not confirm it.
        """
        reply = self._link.ask(f"{self._m}{command}", f"{self._m}{head}")
        if reply != wanted:
            raise DriverError(
                f"the board replies {reply!r} instead of {wanted!r} to {self._m}{command}: it was refused"
            )

    def _limit(self, command: str, value: float, name: str) -> None:
        """Set the limit called `name` to `value`, rounded down, and read it back. Raises DriverError if the board holds
        another value.
        """
        text = f"{math.floor(value * 1e5) / 1e5:.5f}"
        kept = number(self._link.ask(f"{self._m}{command}{text}", f"{self._m}{command}"))
        if kept is None or abs(kept - float(text)) > 1e-4 * value:
            raise DriverError(f"the board refused a {name} limit of {text} and keeps {kept}")

    def _is_zero(self, line: str) -> bool | None:
        value = number(line[len(self._m) :]) if line.startswith(self._m) else None
        return True if value == 0.0 else None

    def _target(self, torque: float) -> str:
        """Return the text of the target for `torque`, N m."""
        self._count += 1
        current = self._config.sign * torque / self._config.torque_constant
        ceiling = self._ceiling - RESOLUTION  # so that the digit that identifies the request stays below the limit too
        return target(max(-ceiling, min(ceiling, current)), self._count)

    def _read(self, commands: list[str], sent: str | None) -> tuple[CommanderState, str]:
        """Send `commands`. Return the state whose target is `sent` (None: any target) and the next line, which says
        whether the motor is enabled.
        """
        head, enabled = f"{self._m}MG", f"{self._m}E"
        reading: CommanderState | None = None
        resent = False

        def both(line: str) -> tuple[CommanderState, str] | None:
            nonlocal reading, resent
            if line.startswith(head):
                reading = state(line[len(head) :])
                if reading is not None and sent is not None and not same(sent, reading.target):
                    reading = None
                    if not resent:  # at once, since a lost digit may mean ten times the current
                        self._link.send(f"{self._m}{sent}")
                    resent = True
            elif reading is not None and line in {enabled + "0", enabled + "1"}:
                return reading, line[len(enabled) :]
            return None

        return self._link.exchange(commands, both, "the state")

    def _check_enabled(self, enabled: str) -> None:
        """Raise DeviceFault if the motor is disabled although armed. Switch the motor off if it is enabled although
        disarmed.
        """
        if not self._gate.armed:
            if enabled == "1":
                self._gate.force_off()
            return
        if enabled == "0":
            raise DeviceFault(
                STOPPED,
                "the board has disabled the motor by itself: its program's watchdog received nothing for too long, or "
                "the program detected a fault; find out what delayed the computer or the link, and check the program",
            )

    def _raise_restarted(self) -> None:
        """Raise DeviceFault if the board prints in the format that it has after a start, else BadReply if the reply is
        not decodable.
        """
        try:
            reply = self._link.ask("@", "@")
        except BadReply as error:
            if _STARTED not in str(error):
                raise
        else:
            if reply == _AWAKE[1:]:
                return
            raise BadReply(f"the reply to @ is damaged ({shown(reply)}): the sample is dropped")
        raise DeviceFault(
            RESTARTED,
            "the board has restarted, and its motor may be enabled: check its supply and its plug, then start again",
        )
