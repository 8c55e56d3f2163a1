"""An emulated CubeMars AK or Damiao motor on a CAN bus, which uses the frames of the MIT mini-cheetah. The plant is
attached to its output.

Sources: those of `mit.tables`, and Damiao's manual for the modes POS_VEL, VEL and FORCE_POS; their current limit is
interpreted as a fraction of the torque range. As in the mini-cheetah's firmware, the motor replies with its state to
every frame for its id; values are truncated to counts, so no count means exactly zero. The following is not in the
manuals and is assumed here. An AK replies with its own id. A Damiao that lost communication is disabled until the
command FB clears the error. An AK's error stays until the motor is switched off. A boot takes 0.2 s, and an AK then no
longer knows its rotor's turns.
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.canbus.impedance import CanMotor, Impedance
from sim_backend.wire.default_joint import fitting_joint
from sim_backend.wire.life import Life
from sim_backend.wire.mit import servo_mode
from sim_backend.wire.mit.tables import MODELS, registers

if TYPE_CHECKING:
    from sim_backend.parameters import SimParameters

BOOT = 0.2
KP_MOST, KD_MOST = 500.0, 5.0
TIMEOUT_LSB = 50e-6
MIT, POSITION_SPEED, SPEED, FORCE_POSITION = 1, 2, 3, 4
"""Values of a Damiao's register CTRL_MODE(10)."""
POSITION_GAIN = 50.0
"""rad/s of commanded speed for each rad of position error."""
SPEED_GAIN = 0.02
"""s/rad, gain of the speed loop divided by the full scale of the torque."""
SPEED_RATE = 200.0
"""rad/s, bandwidth of the speed loop with a heavy rotor: fast enough for `POSITION_GAIN`."""
_FORCE_POSITION = struct.Struct("<fHH")
"""Units of the values in a FORCE_POS command: rad, 0.01 rad/s, 0.0001 of the torque range."""

DISABLED, ENABLED = 0, 1
OVER_CURRENT = {False: 2, True: 10}
TOO_HOT = {False: 1, True: 12}
LOST_COMMUNICATION = 13
"""The error of a Damiao's timeout. Where an error code above depends on the family, it is given for an AK (False) and
for a Damiao (True).
"""

_AK_HOTTEST = 100.0


class MitDevice:
    """An emulated motor of `model` (a key of `tables.MODELS`). Times are s on the bus's clock.

    reply_id: the CAN identifier of the replies; None: as in a new motor, the motor's id for an AK and 0 for a Damiao.
    servo: whether an AK is in servo mode, which is chosen with the vendor's tool. Raises KeyError for a model that is
    not in the table.
    """

    def __init__(
        self,
        model: str,
        ident: int = 1,
        *,
        reply_id: int | None = None,
        servo: bool = False,
        parameters: SimParameters | None = None,
        now: float = 0.0,
    ) -> None:
        self.model = MODELS[model]
        self.damiao = self.model.damiao
        reply = reply_id if reply_id is not None else (0 if self.damiao else ident)
        self._items = registers(self.model, ident, reply) if self.damiao else {}
        self.values = {number: item.initial for number, item in self._items.items()}
        self._stored = dict(self.values)
        self._ident, self._reply = ident, reply
        row = self.model
        joint = parameters or fitting_joint(row.span[2], row.torque_constant, row.resistance, inertia=row.inertia)
        self.motor = CanMotor(joint, Impedance())
        self._damping = max(SPEED_GAIN * row.span[2], SPEED_RATE * self.motor.inertia)
        """N m s/rad of the speed loop."""
        self.error = 0
        self.refused: set[int] = set()
        """Registers whose writes are acknowledged but not carried out: a fault for tests."""
        self._zero = 0.0
        self.life = Life(self.motor, now, self._watches, lambda: self.error == LOST_COMMUNICATION)
        self._report_due = now if servo else math.inf

    @property
    def ident(self) -> int:
        """The id on the bus."""
        return int(self.values[8]) if self.damiao else self._ident

    @property
    def status(self) -> int:
        """The status of a Damiao, or the error code of an AK."""
        if self.error or not self.damiao:
            return self.error
        return ENABLED if self.motor.enabled else DISABLED

    def _watches(self) -> float | None:
        return self.motor.enabled and self.values[9] if self.damiao else None

    def due(self) -> float:
        """Return the time of the next report in servo mode, s; infinity in MIT mode."""
        return self._report_due

    def unasked(self, now: float) -> list[CanFrame]:
        """Return the report that is due."""
        self.advance(now)
        if self._report_due > now:
            return []
        self._report_due = max(self.life.ready, now) + servo_mode.UPLOAD
        return [servo_mode.report(self.ident, self.motor, self.model, self._zero, self.error)]

    def advance(self, now: float) -> None:
        """Simulate the motor up to `now` and check for faults."""
        if self.damiao and self.life.lapses(now, self.values[9] * TIMEOUT_LSB):
            self.fail(LOST_COMMUNICATION)
        self.life.run(now)
        if self.motor.temperature > (self.values[2] if self.damiao else _AK_HOTTEST):
            self.fail(TOO_HOT[self.damiao])

    def fail(self, error: int) -> None:
        """Latch the error `error` and switch the torque off."""
        self.error = self.error or error
        self.motor.disable()

    def reboot(self, now: float) -> None:
        """Switch the torque off, lose the settings that were not stored, and do not reply until the boot has ended."""
        self.life.boot(now, BOOT)
        self.error = 0
        self.values = dict(self._stored)
        if not self.damiao:
            turn = 2.0 * math.pi / self.model.gear
            self._zero += round((self.motor.position - self._zero) / turn) * turn

    def handle(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """Return the replies to a frame."""
        if frame.remote or frame.error or now < self.life.ready:
            return []
        self.advance(now)
        if self._report_due < math.inf:
            self._serve(frame)
            return []
        if frame.extended or len(frame.data) != 8:
            return []
        if self.damiao and frame.ident == 0x7FF:
            return self._register(frame.data, now)
        if frame.ident not in self._listens():
            return []
        self.life.heard = now
        if frame.data[:7] == b"\xff" * 7 and frame.data[7] >= 0xFB:
            self._special(frame.data[7])
        elif self.motor.enabled:
            self._command(frame)
        return [self._state()]

    def _serve(self, frame: CanFrame) -> None:
        """Follow a command in servo mode, in which a motor is enabled by its first command."""
        if not frame.extended or frame.ident & 0xFF != self.ident or self.error:
            return
        if frame.ident >> 8 == servo_mode.ORIGIN:
            self._zero = self.motor.position
        demand = servo_mode.law(frame.ident >> 8, frame.data, self.model, self._zero, self._damping)
        if demand is not None:
            self.motor.enable()
            self.motor.follow(demand)

    def _listens(self) -> set[int]:
        """Return the CAN identifiers of commands that the motor accepts; for a Damiao they depend on its mode."""
        return {self.ident + 0x100 * (int(self.values[10]) - 1), self.ident} if self.damiao else {self.ident}

    def _special(self, code: int) -> None:
        if code == 0xFC and not self.error:
            self.motor.enable()
        elif code == 0xFD and not self.life.ignores_off:
            self.motor.disable()
        elif code == 0xFE and not self.motor.enabled:
            self._zero = self.motor.position
        elif code == 0xFB and self.damiao:
            self.error = 0

    def _command(self, frame: CanFrame) -> None:
        mode = int(self.values[10]) if self.damiao else MIT
        if frame.ident != self.ident + 0x100 * (mode - 1):
            return
        if mode == MIT:
            self.motor.follow(self._impedance(frame.data))
        elif mode == POSITION_SPEED:
            position, speed = struct.unpack("<ff", frame.data)
            self._regulate(position, abs(speed), self._span()[2])
        elif mode == SPEED:
            self._turn(struct.unpack_from("<f", frame.data)[0])
        else:
            position, speed, share = _FORCE_POSITION.unpack(frame.data)
            self._regulate(position, min(speed, 10_000) * 1e-2, min(share, 10_000) * 1e-4 * self._span()[2])

    def _impedance(self, data: bytes) -> Impedance:
        word = int.from_bytes(data, "big")
        counts = (word >> 48, word >> 36 & 0xFFF, word >> 24 & 0xFFF, word >> 12 & 0xFFF, word & 0xFFF)
        position, velocity, torque = self._span()
        return Impedance(
            feedforward=_from_counts(counts[4], -torque, torque, 12),
            kp=_from_counts(counts[2], 0.0, KP_MOST, 12),
            kd=_from_counts(counts[3], 0.0, KD_MOST, 12),
            position=_from_counts(counts[0], -position, position, 16) + self._zero,
            velocity=_from_counts(counts[1], -velocity, velocity, 12),
            ceiling=torque,
        )

    def _regulate(self, position: float, fastest: float, ceiling: float) -> None:
        """Drive to `position`, rad, with a speed of at most `fastest`, rad/s, and a torque of at most `ceiling`, N
        m.
        """
        damping = self._damping
        self.motor.follow(
            Impedance(0.0, POSITION_GAIN * damping, damping, position + self._zero, ceiling=ceiling, fastest=fastest)
        )

    def _turn(self, speed: float) -> None:
        self.motor.follow(Impedance(kd=self._damping, velocity=speed, ceiling=self._span()[2]))

    def _span(self) -> tuple[float, float, float]:
        return (self.values[21], self.values[22], self.values[23]) if self.damiao else self.model.span

    def _state(self) -> CanFrame:
        position, velocity, torque = self._span()
        angle = _to_counts(self.motor.position - self._zero, -position, position, 16)
        rate = _to_counts(self.motor.velocity, -velocity, velocity, 12)
        effort = _to_counts(self.motor.torque, -torque, torque, 12)
        head = self.status << 4 | self.ident & 0xF if self.damiao else self.ident
        body = (head << 40 | angle << 24 | rate << 12 | effort).to_bytes(6, "big")
        warmth = min(255, max(0, int(self.motor.temperature)))
        tail = bytes([warmth, warmth]) if self.damiao else bytes([warmth, self.error])
        return CanFrame(int(self.values[7]) if self.damiao else self._reply, body + tail)

    def _register(self, data: bytes, now: float) -> list[CanFrame]:
        """Execute a register request of a Damiao: read (33), write (55), store (AA), or send the state (CC)."""
        if int.from_bytes(data[:2], "little") != self.ident:
            return []
        self.life.heard = now
        command, number = data[2], data[3]
        reply_id = int(self.values[7])
        if command == 0xCC:
            return [self._state()]
        item = self._items.get(number)
        if command == 0xAA:
            self._stored = self._stored if self.motor.enabled else dict(self.values)
            return [CanFrame(reply_id, data)]
        if item is None or command not in {0x33, 0x55}:
            return []
        layout = "<I" if item.whole else "<f"
        self.values[62 if number == 62 else 61] = self.motor.temperature
        if command == 0x55:
            value = float(struct.unpack_from(layout, data, 4)[0])
            if item.writable and number not in self.refused and item.low <= value <= item.high and math.isfinite(value):
                self.values[number] = value
        kept = self.values[number]
        raw = struct.pack(layout, int(kept) if item.whole else kept)
        return [CanFrame(reply_id, data[:4] + raw)]


def _to_counts(value: float, low: float, high: float, bits: int) -> int:
    """Return a value in counts of `bits` bits, limited to the range from `low` to `high` and truncated, as the firmware
    does.
    """
    bounded = max(low, min(high, value))
    return int((bounded - low) * ((1 << bits) - 1) / (high - low))


def _from_counts(counts: int, low: float, high: float, bits: int) -> float:
    return counts * (high - low) / ((1 << bits) - 1) + low
