"""DYNAMIXEL servos on a serial port as a `drivers.servo.Servo`. Wiring and limits: docs/dynamixel.md.

A tick is one round trip: a Sync Write of the set-point, which has no reply, is sent together with a Read of one block
that holds all measurements. The modules `x` and `mx` hold the differences between the two series.
"""

from __future__ import annotations

import math

from drivers.clock import Clock
from drivers.dynamixel.config import DynamixelConfig
from drivers.dynamixel.identity import RETURN_DELAY_LSB, identify, neighbours
from drivers.dynamixel.models import POSITION_LSB, TURN, DynamixelModel, models
from drivers.dynamixel.mx import MxSeries
from drivers.dynamixel.series import Series
from drivers.dynamixel.x import XSeries
from drivers.gate import Admitted, below_one_count, to_counts
from drivers.neighbours import Neighbour
from drivers.overload import Overload
from drivers.packets.port import SerialPort
from drivers.packets.servo import RegisterServo
from drivers.servo import BadReply, DriverError, Limits, Quantity, Sample, ServoInfo
from drivers.tick import Freshness, TickClock

_LATE = 0.02  # s before the watchdog trips; a later tick checks whether it has
_TRIES = 3


class DynamixelServo(RegisterServo):
    """One servo that is open and identified, with its torque off.

    clock, port: given by tests; None uses the real clock and opens the port of `config`. info.torque_uncertainty is NaN
    if stand.toml states the torque constant. Raises DriverError if the port cannot be opened or another model replies,
    NoReply if no servo replies, BadReply if the replies cannot be decoded.
    """

    def __init__(self, config: DynamixelConfig, *, clock: Clock | None = None, port: SerialPort | None = None) -> None:
        self._config = config
        self._model: DynamixelModel = models()[config.model]
        self._mode = config.effective_mode
        self._constant = config.torque_constant or self._model.torque_constant
        kind = XSeries if self._model.protocol == 2 else MxSeries
        self._series: Series = kind(self._model, config, self._torque_lsb)
        self._off, self._zero_after = self._series.off, self._series.zero_after_off
        self._tick = TickClock()
        self._impossible = 0
        self._ceiling = 0
        self._last_request = -math.inf
        quantity = Quantity.TORQUE if self._mode == "current" else Quantity.POSITION
        position = self._series.registers["present_position"]
        super().__init__(
            config,
            clock,
            port,
            quantity=quantity,
            mode_key="dynamixel.mode",
            wire=self._series.wire,
            registers=self._series.registers,
            eeprom_end=self._series.eeprom_end,
            position=(position.address, position.size),
            counts=position.decoded,
            turn=TURN,
        )
        with self._gate.opening(self._table.settings.restore):
            firmware = identify(self._bus, self._table, config, self._series)
            self.disarm()
            self._table.settings.require("return_delay_time", round(config.return_delay / RETURN_DELAY_LSB))
            self._bus.return_delay = config.return_delay
            self._series.choose_mode(self._table)
        self.info = self._describe(firmware, quantity)

    def _arm(self, limits: Limits) -> None:
        """Write mode, limits and watchdog into the servo, read them back, and switch the torque on at zero current.

        In the position modes the servo then holds its position. The limits of torque, temperature and velocity are
        written to the servo's registers, each no higher than the model's own limit.
        """
        self._ceiling = ceiling = self._torque_counts(limits)
        self._series.raise_latched(self._bus, self._table)
        self._table.settings.require("torque_enable", 0)
        self._series.prepare(self._table, limits, ceiling)
        self._hand.begin(self._table.get("present_position"))
        self._enable(ceiling)

    def _exchange(self, admitted: Admitted) -> Sample:
        """Send the set-point and read the state. In a position mode nothing is written for `Command.rest()`: the servo
        holds its position. Raises DeviceFault also if the watchdog has tripped.
        """
        goal, saturated = self._goal(admitted)
        sent = self.clock.now()
        if self._gate.armed and 0.0 < self._config.watchdog < sent - self._last_request + _LATE:
            self._look_for_faults()
            sent = self.clock.now()
        block = self._series.block
        raw = self._bus.read(*block) if goal is None else self._bus.write_and_read(*goal, *block)
        received = self.clock.now()
        self._last_request = sent
        if self._bus.alert:
            self._look_for_faults()
        sample = self._decoded(raw, sent, received, saturated=saturated)
        if self._hand.watches and self._gate.armed:
            self._hand.look(round(sample.motor_position / POSITION_LSB))
        return sample

    def neighbours(self) -> list[Neighbour]:
        """See `drivers.neighbours.HasNeighbours`."""
        return neighbours(self._bus, self._config.id, self._series)

    def overload(self, limits: Limits) -> Overload | None:
        """See `drivers.overload.HasOverload`."""
        del limits
        return self._series.overload(self._table)

    def slower(self) -> tuple[float, float]:
        """See `drivers.neighbours.SeesNeighbours`."""
        return self._hand.slower(len(self._bus.unanswered(*self._series.goal(0, 0)[:2])))

    def _confirm_off(self) -> None:
        self._table.put("torque_enable", 0)
        if self._table.get("torque_enable"):
            raise DriverError("it is still on")

    def _describe(self, firmware: str, quantity: Quantity) -> ServoInfo:
        stated = self._config.torque_constant is not None
        return ServoInfo(
            backend="dynamixel",
            model=self._config.model,
            serial=f"id {self._config.id}",
            serial_is_id=True,
            firmware=firmware,
            quantities=frozenset({quantity}),
            position_lsb=POSITION_LSB,
            velocity_lsb=self._series.velocity_lsb,
            torque_lsb=self._torque_lsb if self._model.current_lsb else math.nan,
            torque_most=2.0 * self._config.largest_torque,
            torque_uncertainty=math.nan if stated else self._model.torque_uncertainty,
            watchdog=self._config.watchdog,
            watchdog_remedy="set dynamixel.watchdog = 0.1" if self._model.protocol == 2 else "",
        )

    @property
    def _torque_lsb(self) -> float:
        """N m in one count of current."""
        return self._model.current_lsb * self._constant

    def _torque_counts(self, limits: Limits) -> int:
        """Return the torque limit in counts of current. Raises DriverError if it is below one count."""
        if not self._model.current_lsb:
            return 0
        counts = self._series.ceiling(limits.torque)
        if counts < 1:
            raise below_one_count(limits.torque, self._torque_lsb, self._model.name)
        return counts

    def _enable(self, ceiling: int) -> None:
        """Switch the torque on at zero current, or at the present position. ceiling: the torque limit in counts."""
        self._series.enable(self._bus, self._table, ceiling)
        self._table.put("torque_enable", 1)
        if self._table.get("torque_enable") != 1:
            self._look_for_faults()
            raise DriverError("the servo refuses to switch its torque on: reboot it")
        self._last_request = self.clock.now()

    def _goal(self, admitted: Admitted) -> tuple[tuple[int, bytes] | None, bool]:
        """Return (address, bytes) of the set-point, or None if nothing is written; and whether the set-point was
        clipped.
        """
        command = admitted.command
        if command is None:
            return None, False
        lsb = self._torque_lsb if command.quantity is Quantity.TORQUE else POSITION_LSB
        counts = self._config.sign * to_counts(command.value, lsb)
        address, data, written = self._series.goal(counts, self._ceiling)
        return (address, data), admitted.clipped or written != counts

    def _decoded(self, raw: bytes, sent: float, received: float, *, saturated: bool) -> Sample:
        state = self._series.state(raw)
        freshness = Freshness.FRESH if state.tick is None else self._tick.judge(state.tick, sent, received)
        if freshness is Freshness.IMPOSSIBLE:
            self._refuse_impossible()
        self._impossible = 0
        return self._sample(
            (sent, received),
            state.position * POSITION_LSB,
            state.velocity,
            state.current * self._constant if self._model.current_lsb else None,
            temperature=state.temperature,
            voltage=state.voltage,
            saturated=saturated,
            stale=freshness is Freshness.STILL,
        )

    def _refuse_impossible(self) -> None:
        """Raise the error for a sample that contradicts the servo's clock: DeviceFault if the servo restarted, else
        BadReply.
        """
        self._impossible += 1
        if self._impossible == _TRIES or not self._gate.armed:
            self._tick.restart()
        self._bus.quarantine()
        if self._gate.armed:
            self._look_for_faults()
        raise BadReply("the reply is older than its request, or the servo has restarted: the sample is dropped")

    def _look_for_faults(self) -> None:
        """Raise DeviceFault if the servo has latched an error or has stopped by itself."""
        self._series.raise_latched(self._bus, self._table)
        if self._gate.armed:
            self._series.raise_stopped(self._bus, self._table)
