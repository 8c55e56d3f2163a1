"""An emulated RobStride motor on a CAN bus. The plant is attached to its output.

Sources: that of `robstride.tables`; the manual of the RS00 of 2026-01-12, section 5, for MIT frames; and measurements
on real motors in the pull requests of lerobot (4070) and motorbridge (10, 20): the reply with the version, the report
of type 24, the refusal of a read, and that limit_torque has no effect in operation mode. Values are truncated to
counts, so no count means exactly zero. These sources do not state the following, which is assumed here. A motor answers
an operation frame to the host that it heard last. It sends a fault frame to this host once, when the fault occurs, and
cannot run until the fault is cleared. It is enabled without a set-point; in both position modes it holds the present
angle. It keeps its zero without power. The ramps acc_rad, acc_set and dcc_set, the integral of the speed loop, and the
settings of the current loop have no effect. Of CANopen only the device type and the change to another protocol exist.
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.canbus.impedance import CanMotor, Impedance
from sim_backend.wire.default_joint import fitting_joint
from sim_backend.wire.life import Life
from sim_backend.wire.robstride.tables import MODELS, Item, items

if TYPE_CHECKING:
    from sim_backend.parameters import SimParameters

BOOT = 0.2
TIMEOUT_LSB = 5e-5
PRIVATE, CANOPEN, MIT = 0, 1, 2
"""Values of the protocol switch."""
OPERATION, PP, SPEED, CURRENT, CSP = 0, 1, 2, 3, 5
"""Values of run_mode."""
OVERHEAT, DRIVER, UNDERVOLTAGE, OVERVOLTAGE, UNCALIBRATED, STALL = 1, 2, 4, 8, 128, 16384
"""Bits of a fault frame."""
SPEED_GAIN = 0.02
"""s/rad, gain of the speed loop divided by the full scale of the torque, at the delivered spd_kp."""
SPEED_RATE = 200.0
"""rad/s, bandwidth of the speed loop with a heavy rotor, at the delivered spd_kp."""
_DELIVERED_SPEED_GAIN = 6.0
_FEEDBACK_BITS = {OVERHEAT: 4, DRIVER: 2, UNDERVOLTAGE: 1, OVERVOLTAGE: 8, 16: 2, 32: 2, 65536: 2}
_FEEDBACK_BITS |= {UNCALIBRATED: 32, STALL: 16}
_MIT_MODES = {0: OPERATION, 1: CSP, 2: SPEED}
_SETPOINTS = frozenset({"run_mode", "iq_ref", "spd_ref", "loc_ref"})
_KEY = bytes([1, 2, 3, 4, 5, 6])
"""The first bytes of a frame that changes what is stored."""
_CLAMPED_BEFORE = (0, 0, 2, 6)
_WORDS = struct.Struct(">HHHH")


class RobstrideDevice:
    """An emulated motor of `model` (a key of `tables.MODELS`). Times are s on the bus's clock.

    firmware: four numbers; None: the table's. serial: serial number, 64 bits. protocol: the protocol at the start.
    values: the parameters' values by name. refused: parameters whose writes get a reply but have no effect. Raises
    KeyError for a model that is not in the table.
    """

    def __init__(
        self,
        model: str = "rs00",
        ident: int = 1,
        *,
        firmware: tuple[int, ...] | None = None,
        serial: int = 0x3130_4D51_3230_0001,
        protocol: int = PRIVATE,
        parameters: SimParameters | None = None,
        now: float = 0.0,
    ) -> None:
        self.model, self.ident = MODELS[model], ident
        self.firmware = firmware or self.model.firmware
        self._wraps = self.firmware[:2] != _CLAMPED_BEFORE[:2] or self.firmware >= _CLAMPED_BEFORE
        self.most_angle = 4.0 * math.pi if self._wraps else 12.5
        self.protocol = self._next_protocol = protocol
        self._serial = serial.to_bytes(8, "little")
        self._items = items(self.model)
        self._named = {item.name: item for item in self._items.values()}
        self._saved = {item.name: item.initial for item in self._items.values()}
        self._items = {index: item for index, item in self._items.items() if index <= self.model.highest}
        self.values = dict(self._saved)
        row = self.model
        joint = parameters or fitting_joint(row.span[1], row.torque_constant, row.resistance, inertia=row.inertia)
        self.motor = CanMotor(joint, Impedance())
        self._damping = max(SPEED_GAIN * row.span[1], SPEED_RATE * self.motor.inertia)
        self.faults = 0
        self.refused: set[str] = set()
        self._rate = self._next_rate = 1
        self._zero, self._host = 0.0, 0xFD
        self._mit_host = 0
        self.life = Life(self.motor, now, lambda: self.motor.enabled and self.values["canTimeout"])
        self._fault_due = self._report_due = math.inf

    @property
    def angle(self) -> float:
        """The parameter mechPos: the angle from the motor's zero, rad."""
        return self.motor.position - self._zero

    def due(self) -> float:
        """Return the time of the next report or fault frame, s."""
        return min(self._fault_due, self._report_due)

    def unasked(self, now: float) -> list[CanFrame]:
        """Return the fault frame and the report that are due."""
        self.advance(now)
        out = []
        if self._fault_due <= now:
            self._fault_due = math.inf
            out.append(self._to_host(21, self.ident, struct.pack("<II", self.faults, 0)))
        if self._report_due <= now:
            self._report_due = now + self._interval
            out.append(self._feedback(24))
        return out

    def advance(self, now: float) -> None:
        """Simulate the motor up to `now` and check for faults."""
        if self.life.lapses(now, self.values["canTimeout"] * TIMEOUT_LSB):
            self.motor.disable()
        self.life.run(now)
        if self.motor.temperature > self.model.hottest and not self.faults & OVERHEAT:
            self.fail(OVERHEAT)

    def fail(self, fault: int) -> None:
        """Latch the fault `fault` (bits of a fault frame) and switch the torque off."""
        self.faults |= fault
        self.motor.disable()
        self._fault_due = self.life.now if self.protocol == PRIVATE else math.inf

    def reboot(self, now: float) -> None:
        """Switch the torque off, lose the settings that were not stored, and do not reply until the boot has ended."""
        self.life.boot(now, BOOT)
        self.faults, self.life.lapsed, self._host = 0, False, 0xFD
        self.values = dict(self._saved)
        self.protocol, self._rate = self._next_protocol, self._next_rate
        turn, low = 2.0 * math.pi, -math.pi if self.values["zero_sta"] else 0.0
        self._zero += math.floor((self.angle - low) / turn) * turn
        self._fault_due = self._report_due = math.inf

    def handle(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """Return the replies to a frame."""
        if frame.remote or frame.error or frame.fd or now < self.life.ready or self._rate != 1:
            return []
        self.advance(now)
        data = frame.data.ljust(8, b"\0")
        if self.protocol == CANOPEN:
            return self._canopen(frame, data)
        if frame.extended != (self.protocol == PRIVATE) or frame.ident & 0xFF != self.ident:
            return []
        self.life.heard, self.life.lapsed = now, False
        if self.protocol == MIT:
            return [self._mit(frame.ident >> 8, data)]
        return self._private(frame.ident >> 24, frame.ident >> 8, data)

    def _private(self, kind: int, field: int, data: bytes) -> list[CanFrame]:
        if kind == 1:
            if self.values["run_mode"] == OPERATION:
                self._impede([word / 0xFFFF for word in (field & 0xFFFF, *_WORDS.unpack(data))])
            return [self._feedback()]
        self._host = field & 0xFF
        if kind == 4 and data[:2] == b"\x00\xc4" and self.firmware:
            self._act(kind, bytes(8))
            return [self._to_host(2, self._status, b"\x00\xc4\x56" + bytes(self.firmware) + b"\0")]
        if kind == 17:
            return [self._read(data)]
        if kind == 7 and 1 <= field >> 8 & 0xFF <= 127:
            self.ident = field >> 8 & 0xFF
        elif kind == 18:
            self._write(data)
        elif data[:6] == _KEY:
            self._store(kind, data[6])
        else:
            self._act(kind, data)
        if kind in {0, 7, 23, 25}:
            return [CanFrame(self.ident << 8 | 0xFE, self._serial, extended=True)]
        return [self._feedback(24 if kind == 24 else 2)] if kind in {3, 4, 6, 18, 22, 24} else []

    def _impede(self, shares: list[float]) -> None:
        """Follow set-points of torque, angle, velocity and both gains, each as a fraction of its range, if the motor is
        enabled.
        """
        velocity, torque, kp, kd = self.model.span
        torques, angle, speed = (
            (2.0 * share - 1.0) * most for share, most in zip(shares, (torque, self.most_angle, velocity), strict=False)
        )
        law = Impedance(torques, shares[3] * kp, shares[4] * kd, angle + self._zero, speed, ceiling=torque)
        self.motor.follow(law if self.motor.enabled else Impedance())

    def _act(self, kind: int, data: bytes) -> None:
        """Execute a frame of type `kind`: enable (3), stop and clear the faults (4), or set the zero to the present
        angle (6).
        """
        if kind == 3 and not self.faults:
            self.motor.enable()
            self.values |= {"iq_ref": 0.0, "spd_ref": 0.0, "loc_ref": self.angle}
            self._follow()
        elif kind == 4:
            if not self.life.ignores_off:
                self.motor.disable()
            if data[0] == 1 and self.motor.temperature <= self.model.hottest:
                self.faults = 0
        elif kind == 6 and data[0] == 1 and self.values["run_mode"] != PP:
            self._zero, self.values["loc_ref"] = self.motor.position, 0.0
            self._follow()

    def _store(self, kind: int, choice: int) -> None:
        """Execute a frame of type `kind`: save (22), set the bit rate (23) or protocol (25) of the next start, or
        report cyclically (24).
        """
        if kind == 22 and choice == 7:
            self._saved |= {name: value for name, value in self.values.items() if name not in _SETPOINTS}
        elif kind == 23 and 1 <= choice <= 4:
            self._next_rate = choice
        elif kind == 24:
            self._report_due = self.life.heard + self._interval if choice else math.inf
        elif kind == 25 and choice <= MIT:
            self._next_protocol = choice

    def _read(self, data: bytes) -> CanFrame:
        item = self._items.get(int.from_bytes(data[:2], "little"))
        if item is None:
            return self._to_host(17, 1 << 8 | self.ident, bytes(8))
        measured = {"mechPos": self.angle, "mechVel": self.motor.velocity, "torque_fdb": self.motor.torque}
        measured["iqf"] = self.motor.torque / self.model.torque_constant
        value = measured.get(item.name, self.values[item.name])
        raw = item.layout.pack(value if item.layout.format == "<f" else int(value))
        return self._to_host(17, self.ident, (data[:4] + raw).ljust(8, b"\0"))

    def _write(self, data: bytes) -> None:
        item = self._items.get(int.from_bytes(data[:2], "little"))
        if item is None or not item.bounds or item.name in self.refused:
            return
        self._put(item, float(item.layout.unpack_from(data, 4)[0]))

    def _put(self, item: Item, value: float) -> None:
        if item.bounds[0] <= value <= item.bounds[1]:
            self.values[item.name] = value
            if self.values["run_mode"] != OPERATION or item.name == "run_mode":
                self._follow()

    def _follow(self) -> None:
        """Follow the set-points of the present run_mode; operation mode begins without torque."""
        values, mode, constant = self.values, self.values["run_mode"], self.model.torque_constant
        damping = self._damping * max(1e-3, values["spd_kp"]) / _DELIVERED_SPEED_GAIN
        ceiling = min(values["limit_torque"], values["limit_cur"] * constant)
        law = Impedance()
        if mode == CURRENT:
            law = Impedance(values["iq_ref"] * constant, ceiling=values["limit_torque"])
        elif mode == SPEED:
            law = Impedance(kd=damping, velocity=values["spd_ref"], ceiling=ceiling)
        elif mode in {PP, CSP}:
            fastest = values["vel_max" if mode == PP else "limit_spd"]
            target = values["loc_ref"] + self._zero
            law = Impedance(0.0, values["loc_kp"] * damping, damping, target, ceiling=ceiling, fastest=fastest)
        self.motor.follow(law)

    @property
    def _interval(self) -> float:
        return 0.01 + 0.005 * (self.values["EPScan_time"] - 1)

    @property
    def _status(self) -> int:
        """The field of a feedback: mode, fault bits and id."""
        bits = 0
        for fault, bit in _FEEDBACK_BITS.items():
            bits |= bit if self.faults & fault else 0
        return (2 if self.motor.enabled else 0) << 14 | bits << 8 | self.ident

    def _state(self, bits: int) -> tuple[int, int, int, int]:
        """Return angle (16 bits), velocity and torque (`bits` bits) in counts, and the temperature in 0.1 degC."""
        most, (velocity, torque, *_) = self.most_angle, self.model.span
        angle = (self.angle + most) % (2.0 * most) - most if self._wraps else self.angle
        rate, effort = _counts(self.motor.velocity, velocity, bits), _counts(self.motor.torque, torque, bits)
        return _counts(angle, most), rate, effort, min(0xFFFF, max(0, int(10.0 * self.motor.temperature)))

    def _feedback(self, kind: int = 2) -> CanFrame:
        return self._to_host(kind, self._status, _WORDS.pack(*self._state(16)))

    def _to_host(self, kind: int, field: int, data: bytes) -> CanFrame:
        return CanFrame(kind << 24 | field << 8 | self._host, data, extended=True)

    def _mit(self, mode: int, data: bytes) -> CanFrame:
        """Return the reply to an MIT frame. Its data is six bytes FF, a choice and a command, or set-points of
        `mode`.
        """
        choice, command = data[6:]
        if mode:
            self._set_points(mode, data)
        elif data[:6] != b"\xff" * 6:
            word = int.from_bytes(data, "big")
            position, *rest = word >> 48, word >> 36 & 0xFFF, word >> 24 & 0xFFF, word >> 12 & 0xFFF, word & 0xFFF
            velocity, kp, kd, torque = (share / 0xFFF for share in rest)
            if self.values["run_mode"] == OPERATION:
                self._impede([torque, position / 0xFFFF, velocity, kp, kd])
        elif choice == 0xFF or command == 0xFB:
            if command == 0xFB and choice != 0xFF:
                return CanFrame(self._mit_host, bytes([self.ident]) + struct.pack("<I", self.faults) + bytes(3))
            if command in {0xFB, 0xFC, 0xFD, 0xFE}:
                self._act({0xFC: 3, 0xFE: 6}.get(command, 4), bytes([command != 0xFD]))
        elif command == 0xFC:
            self._put(self._named["run_mode"], float(_MIT_MODES.get(choice, -1)))
        else:
            self._choose(choice, command)
            return CanFrame(self.ident, self._serial)
        angle, rate, effort, warmth = self._state(12)
        body = (self.ident << 40 | angle << 24 | rate << 12 | effort).to_bytes(6, "big")
        return CanFrame(self._mit_host, body + warmth.to_bytes(2, "big"))

    def _choose(self, choice: int, command: int) -> None:
        """Set the motor's id (FA), the protocol at the next start (FD), or the host's id."""
        if command == 0xFA and 1 <= choice <= 127:
            self.ident = choice
        elif command == 0xFD and choice <= MIT:
            self._next_protocol = choice
        elif choice == 0xFD and command <= 127:
            self._mit_host = command

    def _set_points(self, mode: int, data: bytes) -> None:
        """Set the set-points of `mode`: angle, rad, and highest speed, rad/s (1), or speed, rad/s, and highest current,
        A (2).
        """
        names = {1: ("limit_spd", "loc_ref"), 2: ("limit_cur", "spd_ref")}.get(mode, ())
        if self.values["run_mode"] == _MIT_MODES.get(mode):
            for name, value in zip(names, reversed(struct.unpack("<ff", data)), strict=False):
                self._put(self._named[name], value)

    def _canopen(self, frame: CanFrame, data: bytes) -> list[CanFrame]:
        """Return the reply to a request for the CANopen device type, or to a change of the protocol."""
        if frame.extended and frame.ident == 0xFFF and data[:6] == _KEY:
            self._store(25, data[6])
            return [CanFrame(self.ident, self._serial)]
        if not frame.extended and frame.ident == 0x600 + self.ident and data[:4] == b"\x40\x00\x10\x00":
            return [CanFrame(0x580 + self.ident, b"\x43\x00\x10\x00\x92\x01\x02\x00")]
        return []


def _counts(value: float, most: float, bits: int = 16) -> int:
    """Return a value in counts as the firmware does: limited to the range and truncated."""
    bounded = max(-most, min(most, value))
    return int((bounded + most) * ((1 << bits) - 1) / (2.0 * most))
