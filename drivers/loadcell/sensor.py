"""A torque cell at the joint, as a `drivers.servo.JointSensor`. A board prints its readings on a serial port.

Boards, lines and calibration: docs/serial.md. The board prints without being asked: each read takes all received lines
and returns the newest valid reading.
"""

from __future__ import annotations

import contextlib
from statistics import median
from typing import TYPE_CHECKING

from drivers.loadcell.clock import BoardClock
from drivers.loadcell.lines import Reading, parsed
from drivers.servo import BadReply, DriverError, LinkLost, NoReply, reason_of
from drivers.uart.lines import TextLines
from drivers.uart.port import GONE, OpenPort, open_port

if TYPE_CHECKING:
    from drivers.clock import Clock
    from drivers.loadcell.config import LoadCellConfig

TARE_READINGS = 16
"""Number of readings from which the tare is taken when the cell is opened."""
PATIENCE = 6.0
"""s to wait for the tare readings: opening a port restarts many boards, which then boot and settle."""
_AT_ONCE = 4096  # bytes
_UNTIMED = 0.05  # s; without the board's clock the time of a reading is only known to lie between two reads


class LoadCell:
    """An open torque cell with a known zero. The joint must be without torque while the cell is opened, so the drive's
    torque must be off.

    tare: the value without torque, in counts or as printed: from the stand file, or the median of the readings at
    opening. Raises DriverError if the port cannot be opened or the zero has drifted, NoReply if too few readings
    arrive, BadReply if the lines are not those of a torque cell.
    """

    def __init__(self, config: LoadCellConfig, *, clock: Clock, port: OpenPort | None = None) -> None:
        self._config = config
        self._clock = clock
        self._lines = TextLines()
        self._board = BoardClock()
        self._last_read = clock.now()
        self._newest = (0.0, 0.0)
        self._in_step = False
        self._closed = False
        self._port: OpenPort = port or open_port(config.port, config.baudrate)
        try:
            readings = self._at_rest()
            self.tare = self._zero([value for _, value in readings])
            self._keep(*readings[-1])
        except BaseException:
            self.close()
            raise

    def read(self) -> tuple[float, float]:
        """Return the time, s, and the joint torque, N m, of the newest reading; the previous reading again if no new
        one has arrived.

        Raises LinkLost, and BadReply if all new lines are damaged.
        """
        readings, trouble = self._take()
        if readings:
            self._keep(*readings[-1])
        elif trouble is not None:
            raise trouble
        return self._newest

    def readings(self) -> list[tuple[float, float]]:
        """Return times, s, and joint torques, N m, of all readings that arrived since the last call of this method or
        of `read`, oldest first.

        Raises LinkLost, and BadReply if all new lines are damaged.
        """
        readings, trouble = self._take()
        if trouble is not None and not readings:
            raise trouble
        out = []
        for reading in readings:
            self._keep(*reading)
            out.append(self._newest)
        return out

    def close(self) -> None:
        """Close the port. Has no effect if the port is closed already."""
        self._closed = True
        with contextlib.suppress(*GONE):
            self._port.close()

    def _keep(self, t: float, value: float) -> None:
        self._newest = t, self._config.sign * self._config.scale * (value - self.tare)

    def _take(self, least: int = 0) -> tuple[list[tuple[float, float]], BadReply | None]:
        """Return the new readings as (time s, value), oldest first, and the error of the last damaged line (None: no
        damaged line).

        least: number of bytes to wait for, up to the read timeout of the port.
        """
        if self._closed:
            raise LinkLost(f"{self._config.port} is closed")
        try:
            wanted = max(self._port.in_waiting, least)
            data = self._port.read(min(wanted, _AT_ONCE)) if wanted else b""
        except GONE as error:
            raise LinkLost(
                f"the torque cell on {self._config.port} is gone ({reason_of(error)}): check its cable"
            ) from None
        now = self._clock.now()
        lines = self._lines.feed(data)
        if lines and not self._in_step:
            self._in_step = True
            lines = lines[1:]  # the first may lack its beginning
        readings: list[tuple[float, float]] = []
        trouble: BadReply | None = None
        for line in lines:
            try:
                readings.append(self._placed(parsed(line, self._config.format), now, line, len(lines)))
            except BadReply as error:
                trouble = error
        self._last_read = now
        if readings and self._board.late(readings[-1][0], now):
            return [], BadReply("the board's clock is behind by half a second: it has restarted; a reading is dropped")
        return readings, trouble

    def _placed(self, reading: Reading, now: float, line: str, count: int) -> tuple[float, float]:
        """Return (time s, value) of a reading. Raises BadReply if the board has restarted.

        now: s, when its line was read. count: number of lines that were read together at `now`.
        """
        sending = 10.0 * (len(line) + 2) / self._config.baudrate
        if reading.micros is None:
            since = min(now - self._last_read, _UNTIMED * count) / count
            return now - 0.5 * since - sending - self._config.delay, reading.value
        t = self._board.place(reading.micros, now)
        if t is None:
            raise BadReply("the board's clock has jumped: it has restarted; a reading is dropped")
        return t - sending - self._config.delay, reading.value

    def _zero(self, values: list[float]) -> float:
        """Return the tare from `values` measured without torque. Raises DriverError if the zero has drifted or is not
        steady.
        """
        config, middle = self._config, median(values)
        half = len(values) // 2
        wander = config.scale * (median(values[half:]) - median(values[:half]))
        if abs(wander) > config.drift:
            raise DriverError(
                f"the torque cell on {config.port} is not steady: its zero moved by {wander:.3g} N m while it "
                "was tared; take every load off the joint, let the cell warm up, and raise joint_sensor.drift if it "
                "always does"
            )
        if config.tare is None:
            return middle
        away = config.sign * config.scale * (middle - config.tare)
        if abs(away) > config.drift:
            raise DriverError(
                f"the torque cell on {config.port} shows {away:.3g} N m while the motor is off, more than "
                f"joint_sensor.drift = {config.drift:g}: take the load off the joint; where there is none, it has "
                f"drifted: set joint_sensor.tare = {middle:.9g}"
            )
        return config.tare

    def _at_rest(self) -> list[tuple[float, float]]:
        """Wait for the readings for the tare and return them as (time s, value). Raises NoReply, BadReply."""
        deadline = self._clock.now() + PATIENCE
        values: list[tuple[float, float]] = []
        trouble: BadReply | None = None
        with contextlib.suppress(*GONE):
            self._port.reset_input_buffer()  # earlier bytes are old
        while len(values) < TARE_READINGS and self._clock.now() < deadline:
            new, bad = self._take(least=1)
            trouble = bad or trouble
            values += new
        if len(values) >= TARE_READINGS:
            return values
        if trouble is not None and not values:
            raise BadReply(
                f"the lines on {self._config.port} at {self._config.baudrate} baud are not a torque cell's with format "
                f"{self._config.format!r} ({trouble}): check joint_sensor.port, baudrate and format"
            )
        raise NoReply(
            f"{len(values)} readings in {PATIENCE:g} s from the torque cell on {self._config.port}, where "
            f"{TARE_READINGS} are needed: check its power, its plug, the baud rate, and that its program prints"
        )
