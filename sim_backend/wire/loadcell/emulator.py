"""An emulated torque cell: a board with an HX711 that prints `micros,raw` lines, or values, on a pty.

Source: HX711 data sheet (AVIA Semiconductor): 24 bit two's complement that stays at 7FFFFF or 800000 hex beyond its
range, 10 or 80 conversions a second, settled after 400 or 50 ms, which is 4 conversions. The sheet does not say how
its filter weighs these; here a reading is the plain mean over them. The first reading after power-on comes when it has
settled. Wire times and the board's clock are the emulator's own.
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
"""Conversions over which a reading is the mean."""
SCALE = 1e-7
"""N m a count, unless the stand file has another."""
_BOOT = 1.0  # s; the board's own start, before the converter settles
_UNREAD = 1.0  # s after which lines that nobody has read are lost


@dataclass(frozen=True, slots=True)
class LoadCellBoard:
    """The construction and the program of the board.

    rate: conversions a second. scale: N m a count. tare: counts without torque. form: "micros,raw" or "value".
    checksum: whether `*` and the exclusive or of the line end it. clock: seconds of its own a second. noise N m, white,
    standard deviation; offset N m and drift N m/s on top of the tare. baudrate: bit/s. usb_latency: s that the adapter
    holds bytes back; None: no time passes on the wire.
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
    """The cell as bytes with times; it sends unasked. micros: of its clock when it is made at `now` s."""

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
        """Each printed line is a reply."""

    def advance(self, now: float) -> None:
        """Do nothing: `receive` returns the lines of the last second, and older ones are lost."""

    def due(self) -> float:
        """Return when it prints its next line, s."""
        return self._next

    def receive(self, data: bytes, now: float, baudrate: int | None = None) -> Sequence[tuple[float, bytes]]:  # noqa: ARG002 - it does not listen
        """The lines it has printed by `now`, and when each has arrived; `baudrate` bit/s is what the host set."""
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
    """Return the bytes that a receiver at another speed reads: not text."""
    return bytes(0x80 | (byte * 37 & 0x7F) for byte in line)[: max(1, round(len(line) / max(1.0, ratio)))]


BOARDS: Mapping[str, LoadCellBoard] = {
    "hx711": LoadCellBoard(),
    "hx711-checked": LoadCellBoard(checksum=True),
    "value": LoadCellBoard(form="value"),
    "adc-1khz": LoadCellBoard(rate=1000.0, checksum=True, baudrate=921_600),
}
"""The boards there are; the last is one with a 24 bit converter of 1000 readings a second."""


def of(sensors: SensorParameters, board: LoadCellBoard = BOARDS["hx711"]) -> LoadCellBoard:
    """A board with the torque cell of [sim.sensors]: its noise, offset and drift, and a count no coarser than its."""
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
    """Return a cell at a joint at rest, at `link`, a symlink to a pty.

    model: "hx711" prints `micros,raw`, "hx711-checked" ends its lines with a checksum, "value" prints counts as plain
    numbers, "adc-1khz" 1000 lines a second with a checksum. baudrate: bit/s, None: the model's. A cell at a joint that
    a motor turns comes with `hil emulate commander`. faults: that happen. Raises ValueError for an unknown model or
    a baud rate that is not above 0.
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
    """A drive's line and the torque cell at its joint, each on a pty of its own."""

    def __init__(self, line: PtyLine, cell: PtyLine) -> None:
        self._line = line
        self._cell = cell

    def serve(self) -> None:
        """Serve both until `stop` is called from another thread or from a signal, then clean up."""
        with self._cell:
            self._line.serve()

    def stop(self) -> None:
        """Make `serve` return."""
        self._line.stop()


class _Locked:
    """The joint of a drive that another thread uses."""

    def __init__(self, joint: Felt, lock: threading.Lock) -> None:
        self._joint = joint
        self._lock = lock

    def mean(self, begin: float, end: float) -> float:
        with self._lock:
            return self._joint.mean(begin, end)


def with_cell(line: PtyLine, joint: Felt, sensors: SensorParameters) -> Pair:
    """Return the drive on `line` with a cell of `sensors` at its `joint`, on a pty named as the line with ".cell"."""
    link = line.link.with_name(f"{line.link.name}.cell")
    cell = EmulatedLoadCell(of(sensors), _Locked(joint, line.lock), now=time.monotonic())
    return Pair(line, PtyLine(link, cell))
