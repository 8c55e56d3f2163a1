"""Emulated SimpleFOC boards on a pty: what `hil emulate commander` serves."""

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
from sim_backend.wire.loadcell.emulator import Pair, with_cell
from sim_backend.wire.plant_motor import PlantMotor
from sim_backend.wire.torque_log import TorqueLog, WatchdogState
from sim_backend.wire.uart.pacing import paced
from sim_backend.wire.uart.pty_line import PtyLine

MODELS = ("motor", "motor+loadcell")
FIRMWARES = ("2.3", "2.4", "2.4-watchdog")
WATCHDOG = 0.1
"""s of silence after which the program with a watchdog (docs/serial.md) disables the motor."""
_BOOT = ("Monitor enabled!", "Init", "Enable driver.", "Align sensor.", "sensor dir: CW", "PP check: OK!", "Ready.")
_SEND_BUFFER = 64
"""Bytes that the board's serial port holds for sending."""
_UNREAD = 1.0
"""s after which lines that nobody has read are lost."""


@dataclass(frozen=True, slots=True)
class CommanderTiming:
    """Durations, s. usb_latency: for which the adapter holds bytes back. loop: of the program, which reads
    commands between two turns of the current loop. boot: from a reset to the first command that it receives.
    """

    usb_latency: float = 1e-3
    loop: float = 1e-4
    boot: float = 3.0


class CommanderBoard:
    """A board as bytes with times. timing: None, where everything but a boot happens at once.

    watchdog: s; 0: none, as in the library's examples. Times are those of whoever calls.
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
        self._tripped = False
        self._baudrate = baudrate
        self._timing = timing
        self.made = now
        self._heard = now
        self._awake = now
        self._free = now
        self.faults = WireFaults[SerialFault]()
        """Each command is a request, each printed line a reply."""
        self._garbled: list[tuple[str, str]] = []
        self._streamed = now

    @property
    def motor(self) -> PlantMotor[MotionControl]:
        """The motor with its settings."""
        return self.device.motor

    @property
    def watchdog_state(self) -> WatchdogState:
        """The state of the watchdog in its program."""
        if not self.watchdog:
            return "none"
        self._tripped = self._tripped and not self.motor.enabled
        return "tripped" if self._tripped else "on" if self.motor.enabled else "off"

    def garble(self, sent: str, received: str) -> None:
        """Let the board once receive `received` where `sent` was sent."""
        self._garbled.append((sent, received))

    def mean(self, begin: float, end: float) -> float:
        """Return the mean torque at the joint from `begin` to `end`, N m, as a torque cell there measures it."""
        self.advance(end)
        return self.device.joint.mean(begin - self.made, end - self.made)

    def reboot(self, now: float) -> None:
        """Lose power for a moment."""
        self.advance(now)
        self.motor.disable()
        self._awake = now + (self._timing or CommanderTiming()).boot

    def advance(self, now: float) -> None:
        """Carry it to `now`, s."""
        if self._awake > self.made and now >= self._awake:
            self.motor.run(self._awake - self.made)
            self.device.restart()
            self._heard, self._awake = self._awake, self.made
        elif self._lapsed(now):
            self.motor.run(self._heard + self.watchdog - self.made)
            self._tripped = True
            self.motor.disable()
            self.motor.law.target = 0.0
        self.motor.run(now - self.made)

    def _lapsed(self, now: float) -> bool:
        """Return whether its program's watchdog acts now."""
        late = bool(self.watchdog and self.motor.enabled and now > self._heard + self.watchdog)
        return late and not self.motor.watchdog_broken

    def due(self) -> float:
        """Return when its program next prints unasked, s."""
        return self._streamed + self._loop * self.device.downsample if self._streams else math.inf

    def receive(self, data: bytes, now: float, baudrate: int | None = None) -> Sequence[tuple[float, bytes]]:
        """Return the lines printed after `data`, whose first byte is sent at `now`, and when each has arrived."""
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
            if self._awake > self.made:  # it does not hear while it boots
                continue
            self._heard = at
            printed = self.device.type(character) if character not in "\n\r" else self._obey(character, at)
            for line in printed.splitlines(keepends=True):
                out += self._reply(line.encode("latin-1"), at)
        return out

    def _monitored(self, now: float) -> list[tuple[float, bytes]]:
        """Return the lines that the program printed by itself since then; it waits where its buffer is full."""
        out: list[tuple[float, bytes]] = []
        self._streamed = max(self._streamed, now - _UNREAD)
        while self._streams and self.due() <= now:
            self._streamed = self.due()
            if self._awake <= self.made:
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
        """s of the program's loop, which calls `motor.monitor()` once."""
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
                return [(self._awake - 0.1, greeting.encode())]
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
    """A board with the plant of `parameters` (None: the paper's joint behind its gear). firmware: see FIRMWARES."""
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
    """Return a board at `link`, a symlink to a pty.

    model: "motor", or "motor+loadcell" for a torque cell at its joint on a second pty, named as `link` with ".cell"
    behind it. firmware: the library's version, "2.4-watchdog" for a program that disables the motor after 0.1 s of
    silence. timing: None answers at once. log: of its torque. faults: that happen. Raises ValueError for a model, a
    firmware or a baud rate that cannot be, FileExistsError if `link` is a file.
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
        log.watch_all([board], now)
    if faults is not None:
        follow(faults, board.faults, [board.motor], now, can=False)
    line = PtyLine(link, board)
    return line if model == "motor" else with_cell(line, board, parameters.sensors)
