"""Feetech servos on a serial port as a `drivers.servo.Servo`. Wiring and limits: docs/feetech.md.

A tick is one round trip: a Sync Write of the set-point, which has no reply, is sent together with a Read of the block
that holds all measurements. An STS or SCS takes positions as set-points; an HLS takes currents too. No Feetech servo
has a watchdog. During a run the EEPROM is locked, so that settings changed by the run are lost without power.
"""

from __future__ import annotations

import math

from drivers.clock import Clock
from drivers.feetech.block import START, Block, FeetechState
from drivers.feetech.config import FeetechConfig
from drivers.feetech.faults import ALERTS, reported, restarted
from drivers.feetech.identity import identify, neighbours
from drivers.feetech.models import CURRENT_LSB, FeetechModel, models, registers
from drivers.gate import Admitted, below_one_count, to_counts
from drivers.neighbours import Neighbour
from drivers.overload import Overload
from drivers.packets.port import SerialPort
from drivers.packets.servo import RegisterServo
from drivers.packets.wire import Wire1
from drivers.servo import BadReply, DriverError, Limits, NoReply, Quantity, Sample, ServoInfo

_POSITION, _CURRENT = 0, 2  # Operating Mode(33)
_FACTORY_TEMPERATURE = 70
_HIGHEST_CURRENT = 2047
_LARGEST = 32767  # magnitude below bit 15
_SINGLE_STEPS = 0x04  # Phase(18) bit 2 of an STS
_GAP = 0.05  # s without a reply after which it is checked whether the servo has restarted
_DELAY_LSB = 2e-6
_EVERYTHING = 256  # an address above all: every setting is restored


class FeetechServo(RegisterServo):
    """One servo that is open and identified, with its torque off.

    clock, port: given by tests; None uses the real clock and opens the port of `config`. info.torque_uncertainty is NaN
    if stand.toml states the torque constant. Raises DriverError if the port cannot be opened or another model replies,
    NoReply if no servo replies, BadReply if the replies cannot be decoded.
    """

    _kept = ("torque_limit", "goal_torque")  # stay zero until the servo is powered up or armed again

    def __init__(self, config: FeetechConfig, *, clock: Clock | None = None, port: SerialPort | None = None) -> None:
        self._config = config
        self._model: FeetechModel = models()[config.model]
        self._registers = registers(self._model.family)
        # the switch is the last, since a goal that is written may switch the torque on
        self._off = tuple(name for name in ("torque_limit", "goal_torque", "torque_enable") if name in self._registers)
        self._block = Block(self._model)
        self._torque_mode = config.effective_mode == "torque"
        self._torque_lsb = CURRENT_LSB * config.constant
        self._ceiling = 0
        self._range = (0, 0)
        self._raw: int | None = None
        self._position = 0
        self._doubtful = False
        self._last_reply = -math.inf
        quantity = Quantity.TORQUE if self._torque_mode else Quantity.POSITION
        super().__init__(
            config,
            clock,
            port,
            quantity=quantity,
            mode_key="feetech.mode",
            wire=Wire1(ALERTS),
            registers=self._registers,
            eeprom_end=_EVERYTHING,
            position=(START, 2),
            counts=self._block.position,
            turn=self._model.turn,
        )
        with self._gate.opening(self._table.settings.restore):
            firmware = identify(self._bus, config)
            self.disarm()
            self._set_up()
        self.info = self._describe(firmware, quantity)

    def _arm(self, limits: Limits) -> None:
        """Write mode and limits into the servo, read them back, and switch the torque on at zero current.

        In position mode the servo then holds its position. The torque limit is rounded down. The limits of temperature
        and velocity are written too; the temperature limit is no higher than the factory's.
        """
        ceiling = self._torque_counts(limits)
        self._raise_reported()
        self._switch(on=False)
        self._prepare(limits, ceiling)
        self._hand.begin(self._block.position(self._bus.read(START, 2)))
        self._enable()

    def _exchange(self, admitted: Admitted) -> Sample:
        """Send the set-point and read the state. In position mode nothing is written for `Command.rest()`: the servo
        holds its position.
        """
        goal, saturated = self._goal(admitted)
        if self._gate.armed and (self._doubtful or self.clock.now() - self._last_reply > _GAP):
            self._look_for_faults()
        sent = self.clock.now()
        block = self._block.request(sent)
        try:
            raw = self._bus.read(*block) if goal is None else self._bus.write_and_read(*goal, *block)
        except (NoReply, BadReply):
            self._doubtful = True
            self._block.lost(self.clock.now())
            raise
        received = self._last_reply = self.clock.now()
        if self._bus.alert:
            raise reported(self._bus.alert)
        sample = self._checked(self._block.state(raw), (sent, received), saturated=saturated)
        if self._hand.watches and self._gate.armed:
            self._hand.look(self._position)
        return sample

    def _restore(self) -> None:
        """Restore the settings that the run changed, but only if the torque is off: one of these settings is the torque
        limit.
        """
        if not self._gate.live:
            self._table.settings.restore()

    def neighbours(self) -> list[Neighbour]:
        """See `drivers.neighbours.HasNeighbours`."""
        return neighbours(self._bus, self._config.id)

    def overload(self, limits: Limits) -> Overload | None:
        """See `drivers.overload.HasOverload`. An STS or SCS measures the load in % of the torque limit of the run."""
        if "overload_torque" not in self._registers:
            return None
        share, time, rest = map(self._table.get, ("overload_torque", "protection_time", "protective_torque"))
        number = self._registers["overload_torque"].address
        acts = (
            f"after {time * 0.01:g} s the servo reduces its torque to {rest} %: Overload Torque({number}) is {share} % "
            f"of the torque limit, Protection Time({number - 1}) {time}, Protective Torque({number - 2}) {rest}"
        )
        return Overload(0.01 * share * limits.torque, acts, f"set Overload Torque({number}) to 100")

    def slower(self) -> tuple[float, float]:
        """See `drivers.neighbours.SeesNeighbours`."""
        goal = self._registers["goal_position"]
        return self._hand.slower(len(self._bus.unanswered(goal.address, bytes(goal.size))))

    def _confirm_off(self) -> None:
        self._switch(on=False)

    def _switch(self, *, on: bool) -> None:
        """Write Torque Enable(40), 0 or 1, and read it back. Raises DriverError if the servo reports another value."""
        self._table.put("torque_enable", int(on))
        # three bytes, so that the late reply to another request cannot be taken for the confirmation
        if self._bus.read(self._registers["torque_enable"].address, 3)[0] != int(on):
            raise DriverError("it refuses to switch its torque on" if on else "it is still on")

    def _set_up(self) -> None:
        """Set the return delay, and find out in which unit the servo gives its speed."""
        if "return_delay" in self._registers:
            self._table.settings.require("return_delay", round(self._config.return_delay / _DELAY_LSB))
        self._bus.return_delay = self._config.return_delay
        if "phase" in self._registers and self._table.get("phase") & _SINGLE_STEPS:
            self._block.speed_unit = 1

    def _describe(self, firmware: str, quantity: Quantity) -> ServoInfo:
        known = bool(self._config.constant)
        stated = self._config.torque_constant is not None or not known
        return ServoInfo(
            backend="feetech",
            model=self._config.model,
            serial=f"id {self._config.id}",
            serial_is_id=True,
            firmware=firmware,
            quantities=frozenset({quantity}),
            position_lsb=self._model.position_lsb,
            velocity_lsb=self._block.velocity_lsb,
            torque_lsb=self._torque_lsb if known else math.nan,
            torque_most=2.0 * self._config.largest_torque,
            torque_uncertainty=math.nan if stated else self._model.torque_uncertainty,
        )

    def _torque_counts(self, limits: Limits) -> int:
        """Return the torque limit in the servo's counts. Raises DriverError if it is below one count."""
        lsb = self._torque_lsb if self._model.has_torque_mode else self._model.stall / 1000.0
        counts = min(math.floor(limits.torque / lsb + 1e-9), _HIGHEST_CURRENT if self._model.has_torque_mode else 1000)
        if counts < 1:
            raise below_one_count(limits.torque, lsb, self._model.name)
        return counts

    def _prepare(self, limits: Limits, ceiling: int) -> None:
        """Write mode and limits and read them back. The torque must be off. ceiling: the torque limit in counts."""
        require = self._table.settings.require
        require("lock", 1)
        if "operating_mode" in self._registers:
            require("operating_mode", _CURRENT if self._torque_mode else _POSITION)
            require("angular_resolution", 1)
            require("acceleration", 0)
        else:
            require("goal_time", 0)
        require("temperature_limit", min(math.floor(limits.temperature), _FACTORY_TEMPERATURE))
        velocity = math.floor(limits.velocity / self._block.velocity_lsb)
        require("goal_velocity", max(1, min(velocity, _LARGEST)))
        require("protection_current" if self._model.has_torque_mode else "torque_limit", ceiling)
        if self._model.has_torque_mode:
            require("torque_limit", self._table.get("max_torque"))  # torque-off may have left it at zero
            require("goal_torque", 0 if self._torque_mode else ceiling)
        self._ceiling = ceiling

    def _enable(self) -> None:
        """Switch the torque on at zero current, or at the present position, whose write already switches it on."""
        self._follow(self._block.state(self._bus.read(*self._block.request(self.clock.now()))).raw)
        if not self._torque_mode:
            self._find_range()
            self._table.put("goal_position", self._raw or 0)
        self._switch(on=True)
        self._doubtful = False
        self._last_reply = self.clock.now()

    def _find_range(self) -> None:
        """Read the range of goal positions that the servo accepts. Raises DriverError if the present position is
        outside.
        """
        low, high = self._table.get("min_position_limit"), self._table.get("max_position_limit")
        if low == high == 0 and self._model.turn:
            low, high = -_LARGEST, _LARGEST
        if not low <= (self._raw or 0) <= high:
            raise DriverError(
                f"the servo is at {self._raw}, outside its position limits {low} to {high}, and would jump when its "
                "torque is switched on: turn it into them, or correct Minimum and Maximum Angle Limit (9 and 11)"
            )
        self._range = (low, high)

    def _goal(self, admitted: Admitted) -> tuple[tuple[int, bytes] | None, bool]:
        """Return (address, bytes) of the set-point, or None if nothing is written; and whether the set-point was
        clipped.
        """
        command = admitted.command
        if command is None:
            return None, False
        if command.quantity is Quantity.TORQUE:
            register, lsb, (low, high), off = "goal_torque", self._torque_lsb, (-self._ceiling, self._ceiling), 0
        else:  # the servo may count within one turn
            off = self._position - (self._raw or 0)
            register, lsb, (low, high) = "goal_position", self._model.position_lsb, self._range
        counts = self._config.sign * to_counts(command.value, lsb) - off
        clipped = max(low, min(high, counts))
        item = self._registers[register]
        return (item.address, item.encoded(clipped)), admitted.clipped or clipped != counts

    def _checked(self, state: FeetechState, times: tuple[float, float], *, saturated: bool) -> Sample:
        torque = state.current * self._config.constant
        self.info.check_readings(state.raw, state.velocity, torque)  # before a damaged position is taken for a turn
        self._follow(state.raw)
        return self._sample(
            times,
            self._position * self._model.position_lsb,
            state.velocity,
            torque if self._config.constant else None,
            temperature=state.temperature,
            voltage=state.voltage,
            saturated=saturated,
        )

    def _follow(self, raw: int) -> None:
        """Store a new raw position and count the turns; between two readings the motor must turn less than half a
        turn.
        """
        turn = self._model.turn
        if self._raw is None:
            self._position = raw
        else:
            moved = raw - self._raw
            self._position += (moved + turn // 2) % turn - turn // 2 if turn else moved
        self._raw = raw

    def _raise_reported(self) -> None:
        self._bus.ping(0)
        if self._bus.alert:
            raise reported(self._bus.alert)

    def _look_for_faults(self) -> None:
        """Raise DeviceFault if the servo reports an error or has stopped by itself."""
        self._raise_reported()
        if self._bus.read(self._registers["torque_enable"].address, 3)[0] != 1:
            raise restarted()
        self._doubtful = False
