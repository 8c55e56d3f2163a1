"""Emulated SimpleFOC boards on a pty, as `hil emulate commander` serves them."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sim_backend.fault_plan import FaultPlan
from sim_backend.parameters import SimParameters
from sim_backend.wire.commander.device import CommanderDevice
from sim_backend.wire.commander.motion import MotionControl
from sim_backend.wire.faults import Reboots, SerialFault, Unplug, WireFaults, follow
from sim_backend.wire.life import Life
from sim_backend.wire.loadcell.emulator import Pair, with_cell
from sim_backend.wire.plant_motor import PlantMotor
from sim_backend.wire.torque_log import TorqueLog
from sim_backend.wire.uart.pacing import paced
from sim_backend.wire.uart.pty_line import PtyLine

MODELS = ("motor", "motor+loadcell")
FIRMWARES = ("2.3", "2.4", "2.4-watchdog")
WATCHDOG = 0.1
"""s of silence after which the board's program with a watchdog (docs/serial.md) disables the motor."""
_BOOT = ("Monitor enabled!", "Init", "Enable driver.", "Align sensor.", "sensor dir: CW", "PP check: OK!", "Ready.")
_SEND_BUFFER = 64
"""Number of bytes that the send buffer of the board's serial port holds."""
_UNREAD = 1.0
"""s after which lines that no client has read are lost."""


@dataclass(frozen=True, slots=True)
class CommanderTiming:
    """Durations, s. usb_latency: how long the adapter holds bytes back. loop: one loop of the board's program, which
    reads commands between two loops. boot: time from a reset until the board receives commands.
    """

    usb_latency: float = 1e-3
    loop: float = 1e-4
    boot: float = 3.0


class CommanderBoard:
    """An emulated board on a serial line: bytes in, bytes with times out. Times are s on the caller's clock.

    timing: durations; None: only a boot takes time. watchdog: s of silence after which the program disables the motor;
    0: never, as in the library's examples.
    """

    def __init__(
        self,
        device: CommanderDevice,
        *,
        baudrate: int = 1_000_000,
        timing: CommanderTiming | None = None,
        watchdog: float = 0.0,
        now: float = 0.0,
    ) -> None:
        self.device = device
        self.unplugged = False
        self.watchdog = watchdog
        self._baudrate = baudrate
        self._timing = timing
        self.life = Life(device.motor, now, lambda: self.motor.enabled if self.watchdog else None)
        self._boots = False
        self._free = now
        self.faults = WireFaults[SerialFault]()
        """The injected faults. Each command counts as a request, each printed line as a reply."""
        self._garbled: list[tuple[str, str]] = []
        self._streamed = now

    @property
    def motor(self) -> PlantMotor[MotionControl]:
        """The motor with its demand law."""
        return self.device.motor

    def garble(self, sent: str, received: str) -> None:
        """Replace the text `sent` by `received` the next time that a client sends it: a transmission error."""
        self._garbled.append((sent, received))

    def mean(self, begin: float, end: float) -> float:
        """Return the mean torque at the joint from `begin` to `end`, s, in N m, which a torque cell at the joint
        measures.
        """
        self.advance(end)
        return self.device.joint.mean(begin - self.life.powered, end - self.life.powered)

    def reboot(self, now: float) -> None:
        """Cut the board's power for a moment."""
        self.advance(now)
        self.life.boot(now, (self._timing or CommanderTiming()).boot)
        self._boots = True

    def advance(self, now: float) -> None:
        """Simulate the board up to `now`, s."""
        if self._boots and now >= self.life.ready:
            self.life.run(self.life.ready)
            self.device.restart()
            self.life.heard, self._boots = self.life.ready, False
        elif self.life.lapses(now, self.watchdog):
            self.motor.disable()
            self.motor.law.target = 0.0
        self.life.run(now)

    def due(self) -> float:
        """Return the time at which the program next prints a line of `motor.monitor()`, s."""
        return self._streamed + self._loop * self.device.downsample if self._streams else math.inf

    def receive(self, data: bytes, now: float, baudrate: int | None = None) -> Sequence[tuple[float, bytes]]:
        """Receive `data`, whose first byte is sent at `now`. Return the printed lines, each with its time of arrival,
        s.

        baudrate: bit/s that the client has set; None: the right one.
        """
        out: list[tuple[float, bytes]] = []
        self.advance(now)
        if baudrate not in {None, self._baudrate}:
            return [(now, bytes(0x80 | byte for byte in data))] if data else []
        out += self._monitored(now)
        text = data.decode("latin-1")
        for sent, received in list(self._garbled):
            if sent in text:
                text = text.replace(sent, received, 1)
                self._garbled.remove((sent, received))
        at = now
        for character in text:
            at += self._duration(1)
            if self._boots:  # it does not hear while it boots
                continue
            self.life.heard = at
            printed = self.device.type(character) if character not in "\n\r" else self._obey(character, at)
            for line in printed.splitlines(keepends=True):
                out += self._reply(line.encode("latin-1"), at)
        return out

    def _monitored(self, now: float) -> list[tuple[float, bytes]]:
        """Return the lines that `motor.monitor()` printed since the last call. The program waits while its send buffer
        is full.
        """
        out: list[tuple[float, bytes]] = []
        self._streamed = max(self._streamed, now - _UNREAD)
        while self._streams and self.due() <= now:
            self._streamed = self.due()
            if not self._boots:
                out += self._reply(self.device.monitored().encode(), self._streamed)
                self._streamed = max(self._streamed, self._free - _SEND_BUFFER * self._duration(1))
        if not self._streams:
            self._streamed = now
        return out

    @property
    def _streams(self) -> bool:
        """Return whether `motor.monitor()` prints lines."""
        return self.device.downsample > 0 and "1" in self.device.watched

    @property
    def _loop(self) -> float:
        """The time, s, of one loop of the board's program; each loop calls `motor.monitor()` once."""
        return (self._timing or CommanderTiming()).loop

    def _obey(self, end: str, at: float) -> str:
        self.advance(at)
        if self.faults.loses_request(at):
            self.device.forget()
        return self.device.type(end)

    def _reply(self, line: bytes, at: float) -> list[tuple[float, bytes]]:
        match self.faults.interrupts_reply(at):
            case Unplug():
                self.unplugged = True
                return []
            case Reboots():
                self.reboot(at)
                greeting = "".join(f"MOT: {line}\r\n" for line in _BOOT)
                return [(self.life.ready - 0.1, greeting.encode())]
        loop, latency = (self._timing.loop, self._timing.usb_latency) if self._timing else (0.0, 0.0)
        self._free = max(self._free, at + loop) + self._duration(len(line))
        return paced(self.faults.arriving(line, self._free), self._duration(1), latency)

    def _duration(self, size: int) -> float:
        return 10.0 * size / self._baudrate if self._timing else 0.0


def new_board(
    parameters: SimParameters | None = None,
    *,
    firmware: str = "2.4",
    baudrate: int = 1_000_000,
    timing: CommanderTiming | None = None,
    now: float = 0.0,
) -> CommanderBoard:
    """Return an emulated board with the plant of `parameters` (None: the paper's joint behind its gear).

    firmware: one of FIRMWARES. timing: durations; None: only a boot takes time. now: s, when the board is powered.
    """
    version = (2, 3) if firmware == "2.3" else (2, 4)
    watchdog = WATCHDOG if firmware.endswith("watchdog") else 0.0
    device = CommanderDevice(parameters or SimParameters(), version=version)
    return CommanderBoard(device, baudrate=baudrate, timing=timing, watchdog=watchdog, now=now)


def serve(
    link: Path,
    model: str = "motor",
    firmware: str = "2.4",
    *,
    baudrate: int = 1_000_000,
    parameters: SimParameters | None = None,
    timing: CommanderTiming | None = None,
    log: TorqueLog | None = None,
    faults: FaultPlan | None = None,
) -> PtyLine | Pair:
    """Return an emulated board at `link`, a symlink to a pty.

    model: "motor", or "motor+loadcell" with a torque cell at its joint, on a second pty whose name is `link` with
    ".cell" appended. firmware: the library's version; "2.4-watchdog" is a program that disables the motor after 0.1 s
    of silence. timing: durations; None: nothing but a boot takes time. log: where the torque is logged. faults: the
    faults that will happen. Raises ValueError for an impossible model, firmware or baud rate, FileExistsError if `link`
    is a file.
    """
    if model not in MODELS:
        raise ValueError(f"model {model!r} is not known: choose one of {', '.join(MODELS)}")
    if firmware not in FIRMWARES:
        raise ValueError(f"firmware {firmware!r} is not known: choose one of {', '.join(FIRMWARES)}")
    if baudrate <= 0:
        raise ValueError(f"baud rate {baudrate}: it must be above 0")
    parameters = parameters or SimParameters()
    now = time.monotonic()
    board = new_board(parameters, firmware=firmware, baudrate=baudrate, timing=timing, now=now)
    if log is not None:
        log.watch_all([board.life])
    if faults is not None:
        follow(faults, board.faults, [board.motor], now, can=False)
    line = PtyLine(link, board)
    return line if model == "motor" else with_cell(line, board, parameters.sensors)
