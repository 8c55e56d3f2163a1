"""An emulated torque cell: a board with an HX711 that prints `micros,raw` lines, or values, on a pty.

Source: HX711 data sheet (AVIA Semiconductor): 24 bit two's complement; 7FFFFF or 800000 hex beyond its range; 10 or 80
conversions a second; settled after 400 or 50 ms, which is 4 conversions. The data sheet does not say how the
converter's filter weighs these 4 conversions; here a reading is their plain mean. The first reading after power-on
comes when the converter has settled. The times on the wire and the board's clock are this emulator's choice.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import xor
from typing import TYPE_CHECKING

import numpy as np

from sim_backend.fault_plan import FaultPlan
from sim_backend.parameters import SensorParameters, SimParameters
from sim_backend.wire.faults import Reboots, SerialFault, Unplug, WireFaults, follow
from sim_backend.wire.loadcell.joint_torque import AtRest, Felt
from sim_backend.wire.uart.pacing import paced
from sim_backend.wire.uart.pty_line import PtyLine

if TYPE_CHECKING:
    from pathlib import Path

SETTLING = 4
"""Number of conversions whose mean is a reading."""
SCALE = 1e-7
"""N m in one count, if the stand file states no other value."""
_BOOT = 1.0  # s; the board's own start, before the converter settles
_UNREAD = 1.0  # s after which lines that nobody has read are lost


@dataclass(frozen=True, slots=True)
class LoadCellBoard:
    """The properties of an emulated board with a torque cell.

    rate: conversions a second. scale: N m in one count. tare: counts without torque. form: "micros,raw" or "value".
    checksum: whether a line ends with `*` and the exclusive or of its characters. clock: s that the board's clock
    advances in one second. noise: white noise, standard deviation, N m. offset, drift: error of the zero, N m, and its
    growth, N m/s. baudrate: bit/s. usb_latency: s that the adapter holds bytes back; None: nothing takes time.
    """

    rate: float = 80.0
    scale: float = SCALE
    tare: int = 84_000
    form: str = "micros,raw"
    checksum: bool = False
    clock: float = 1.0
    noise: float = 0.0
    offset: float = 0.0
    drift: float = 0.0
    baudrate: int = 115200
    usb_latency: float | None = 1e-3


class EmulatedLoadCell:
    """An emulated torque cell on a serial line: it prints lines without requests, as bytes with times.

    micros: what the board's clock shows at `now`, s, when the object is made.
    """

    def __init__(
        self,
        board: LoadCellBoard | None = None,
        joint: Felt | None = None,
        *,
        now: float = 0.0,
        micros: int = 0,
        seed: int = 0,
    ) -> None:
        self.board = board or LoadCellBoard()
        self.unplugged = False
        self._joint = joint or AtRest()
        self._made = now
        self._powered = now - micros * 1e-6
        self._rng = np.random.default_rng(seed)
        self._next = now + SETTLING / self.board.rate
        self.faults = WireFaults[SerialFault]()
        """The injected faults. Each printed line counts as a reply."""

    def advance(self, now: float) -> None:
        """Do nothing: `receive` returns the lines of the last second, and older lines are lost."""

    def due(self) -> float:
        """Return the time at which the cell prints its next line, s."""
        return self._next

    def receive(self, data: bytes, now: float, baudrate: int | None = None) -> Sequence[tuple[float, bytes]]:  # noqa: ARG002 - it does not listen
        """Return the lines that the cell has printed by `now`, each with its time of arrival, s. baudrate: bit/s that
        the host has set.
        """
        out: list[tuple[float, bytes]] = []
        self._next += max(0, math.floor((now - _UNREAD - self._next) * self.board.rate)) / self.board.rate
        while self._next <= now and not self.unplugged:
            taken = self._next
            self._next += 1.0 / self.board.rate
            line = self._line(taken)
            match self.faults.interrupts_reply(taken):
                case Unplug():
                    self.unplugged = True
                    break
                case Reboots():
                    self._powered = taken + _BOOT
                    self._next = self._powered + SETTLING / self.board.rate
                    break
            held = self.board.usb_latency
            byte = 10.0 / self.board.baudrate if held is not None else 0.0
            ends = taken + byte * len(line)
            if baudrate is not None and baudrate != self.board.baudrate:
                line = _misread(line, self.board.baudrate / max(1, baudrate))
            out += paced(self.faults.arriving(line, ends), byte, held or 0.0)
        return out

    def _line(self, taken: float) -> bytes:
        board = self.board
        torque = self._joint.mean(taken - SETTLING / board.rate, taken) + board.offset
        torque += board.drift * (taken - self._made) + board.noise * self._rng.standard_normal()
        if board.form == "value":
            text = f"{torque / board.scale:.4f}"
        else:
            raw = board.tare + math.floor(torque / board.scale + 0.5)
            micros = int((taken - self._powered) * board.clock * 1e6) % (1 << 32)
            text = f"{micros},{max(-0x800000, min(0x7FFFFF, raw))}"
        if board.checksum:
            text += f"*{reduce(xor, text.encode()):02X}"
        return text.encode() + b"\r\n"


def _misread(line: bytes, ratio: float) -> bytes:
    """Return the bytes that a host with a wrong baud rate receives instead of `line`: they are not text. ratio: the
    board's baud rate divided by the host's.
    """
    return bytes(0x80 | (byte * 37 & 0x7F) for byte in line)[: max(1, round(len(line) / max(1.0, ratio)))]


BOARDS: Mapping[str, LoadCellBoard] = {
    "hx711": LoadCellBoard(),
    "hx711-checked": LoadCellBoard(checksum=True),
    "value": LoadCellBoard(form="value"),
    "adc-1khz": LoadCellBoard(rate=1000.0, checksum=True, baudrate=921_600),
}
"""The emulated boards by name. The last has a 24 bit converter with 1000 readings a second."""


def of(sensors: SensorParameters, board: LoadCellBoard = BOARDS["hx711"]) -> LoadCellBoard:
    """Return `board` with the noise, offset and drift of the torque cell of [sim.sensors], and with one count no larger
    than that cell's.
    """
    return replace(
        board,
        scale=min(SCALE, sensors.torque_cell_lsb),
        noise=sensors.torque_cell_noise,
        offset=sensors.torque_cell_offset,
        drift=sensors.torque_cell_drift,
    )


def serve(
    link: Path,
    model: str = "hx711",
    *,
    baudrate: int | None = None,
    parameters: SimParameters | None = None,
    faults: FaultPlan | None = None,
) -> PtyLine:
    """Return an emulated torque cell at a joint without torque, at `link`, a symlink to a pty.

    model: "hx711" prints `micros,raw`; "hx711-checked" adds a checksum to each line; "value" prints counts as plain
    numbers; "adc-1khz" prints 1000 lines a second with a checksum. baudrate: bit/s; None: the model's. faults: the
    faults that will happen. For a cell at a joint that a motor turns, use `hil emulate commander`. Raises ValueError
    for an unknown model or a baud rate that is not above 0.
    """
    if model not in BOARDS:
        raise ValueError(f"model {model!r} is not known: choose one of {', '.join(BOARDS)}")
    if baudrate is not None and baudrate <= 0:
        raise ValueError(f"baud rate {baudrate}: it must be above 0")
    board = of((parameters or SimParameters()).sensors, BOARDS[model])
    board = replace(board, baudrate=baudrate or board.baudrate)
    now = time.monotonic()
    cell = EmulatedLoadCell(board, now=now)
    if faults is not None:
        follow(faults, cell.faults, [], now, can=False)
    return PtyLine(link, cell)


class Pair:
    """The line of an emulated drive together with a torque cell at its joint, each on its own pty."""

    def __init__(self, line: PtyLine, cell: PtyLine) -> None:
        self._line = line
        self._cell = cell

    def serve(self) -> None:
        """Serve both lines until `stop` is called from another thread or from a signal, then close them."""
        with self._cell:
            self._line.serve()

    def stop(self) -> None:
        """Make `serve` return."""
        self._line.stop()


class _Locked:
    """The joint of a drive that another thread simulates, read under that thread's lock."""

    def __init__(self, joint: Felt, lock: threading.Lock) -> None:
        self._joint = joint
        self._lock = lock

    def mean(self, begin: float, end: float) -> float:
        with self._lock:
            return self._joint.mean(begin, end)


def with_cell(line: PtyLine, joint: Felt, sensors: SensorParameters) -> Pair:
    """Return the drive on `line` together with a torque cell at its `joint`. The cell's pty is named as the line, with
    ".cell" appended.
    """
    link = line.link.with_name(f"{line.link.name}.cell")
    cell = EmulatedLoadCell(of(sensors), _Locked(joint, line.lock), now=time.monotonic())
    return Pair(line, PtyLine(link, cell))
