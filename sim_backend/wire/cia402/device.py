"""An emulated CiA 402 drive on a CAN bus: an EPOS4, an EPOS2, or a plain CiA 402 drive. The plant is attached to its
motor.

Sources: CiA 402-2 for states and objects, the maxon firmware specifications for units. The following is not in these
sources, or is simplified here. In torque modes, no torque is applied that would accelerate the motor beyond the speed
limit. A lost heartbeat switches the power stage off whatever 0x6007 says (and latches 0x8130). In an active quick stop
the drive brakes. Objects for averages hold present values. Two modes can be set: the torque mode, whose objects exist,
and the mode as delivered, in which no current flows.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from sim_backend.wire.canbus.impedance import CanMotor, Impedance
from sim_backend.wire.canopen.dictionary import BAD_SIGNATURE, RANGE, Abort, Dictionary, eds
from sim_backend.wire.canopen.node import HEARTBEAT_LOST, OPERATIONAL, CanopenNode
from sim_backend.wire.cia402.machine import REMOTE, VOLTAGE, Cia402Machine, Cia402State
from sim_backend.wire.cia402.tables import GROUPS, MODELS, TORQUE_CONSTANT, entries
from sim_backend.wire.default_joint import fitting_joint
from sim_backend.wire.life import Life

if TYPE_CHECKING:
    from sim_backend.parameters import SimParameters
    from sim_backend.wire.canbus.frames import CanFrame

TURN = 2.0 * math.pi
OVERTEMPERATURE = 0x4210
OVERCURRENT = 0x2310
FOLLOWING_ERROR = 0x8611
_OFFSET_MEASURED = 0x100
"""Bit of an EPOS2's statusword: the offset of the current sensors has been measured."""
_DELIVERED = 1
"""Value of 0x6060 in a new drive: profile position mode."""
_SAVE, _LOAD = 0x65766173, 0x64616F6C
_REGISTER = {0x2: 0x02, 0x3: 0x04, 0x4: 0x08, 0x8: 0x10}
"""Bits of the error register by the first hex digit of the error code. Bit 0 is always set too."""


class Cia402Device:
    """An emulated drive `model` (of `MODELS`) with node id `ident`. Times are s on the bus's clock."""

    def __init__(
        self,
        model: str = "epos4",
        ident: int = 1,
        *,
        parameters: SimParameters | None = None,
        now: float = 0.0,
        serial: int = 0x62004411,
    ) -> None:
        self.model = MODELS[model]
        self.kind = model
        self.machine = Cia402Machine()
        self.objects = Dictionary(entries(model, ident), GROUPS)
        joint = parameters or fitting_joint(self._ceiling(), TORQUE_CONSTANT, 0.6)
        self.motor = CanMotor(joint, Impedance())
        identity: dict[tuple[int, int], int | str] = {
            (0x1008, 0): self.model.name,
            (0x1018, 1): self.model.vendor,
            (0x1018, 2): self.model.product,
            (0x1018, 3): self.model.revision,
            (0x1018, 4): serial,
            (0x6502, 0): _mode_bit(self.model.mode),
        }
        for key, value in identity.items():
            self.objects.put(*key, value)
        self._zero = 0.0
        self.life = Life(self.motor, now, lambda: self.node.watches, self._silenced)
        self._hook()
        self.node = CanopenNode(ident, self.objects, self, now)

    def _silenced(self) -> bool:
        return self.machine.state is Cia402State.FAULT and self.objects.get(0x1003, 1) == HEARTBEAT_LOST

    @property
    def eds(self) -> str:
        """The text of the drive's electronic data sheet."""
        model = self.model
        return eds(self.objects, vendor=model.vendor, product=model.product, revision=model.revision, name=model.name)

    # -- the node's side of the bus ---------------------------------------------------------------------------------

    def due(self) -> float:
        """Return the time at which the drive next sends a frame without a request or changes its state, s."""
        return min(self.node.due(), self.machine.due())

    def unasked(self, now: float) -> list[CanFrame]:
        """Return the frames that the drive sends without a request at `now`."""
        self.advance(now)
        return self.node.unasked(now)

    def advance(self, now: float) -> None:
        """Simulate the motor up to `now`."""
        self.machine.advance(now)
        self._control()
        self.life.run(now)
        self.node.advance(now)
        hot = self.objects.entries.get((0x3201, 4))
        too_hot = hot is not None and self.motor.temperature * 10.0 > self.objects.get(0x3201, 4)
        if too_hot and self.machine.state is not Cia402State.FAULT:
            self.fail(OVERTEMPERATURE)
        self._control()

    def handle(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """Return the replies to a frame."""
        self.advance(now)
        return self.node.handle(frame, now)

    def reboot(self, now: float) -> None:
        """Cut the drive's power for a moment: the contents of the RAM, the position and faults are lost."""
        self.restarted(now)
        self.node.reset(now, application=True)

    def fail(self, code: int) -> None:
        """Latch the fault `code` and send it in an EMCY."""
        self.machine.fail()
        self.motor.disable()
        count = self.objects.get(0x1003)
        for place in range(min(count, 4), 0, -1):
            self.objects.put(0x1003, place + 1, self.objects.get(0x1003, place))
        self.objects.put(0x1003, 0, min(count + 1, 5))
        self.objects.put(0x1003, 1, code)
        self.objects.put(0x1001, 0, 1 | _REGISTER.get(code >> 12, 0))
        if (0x603F, 0) in self.objects.entries:
            self.objects.put(0x603F, 0, code)
        self.node.emergency(code)

    # -- canopen.node.Application -----------------------------------------------------------------------------------

    def receive(self, index: int, _sub: int, value: int, now: float) -> None:
        """Act on an object that a PDO has written."""
        if index == 0x6040:
            self._command(value, now)
        elif index == 0x6060:
            self.objects.put(0x6061, 0, value)
        self._control()

    def connection_lost(self, code: int, _now: float) -> None:
        """Latch the fault of the EMCY `code`; for code 0, only switch the torque off."""
        if self.motor.watchdog_broken:
            return
        live = self.machine.state in {
            Cia402State.OPERATION_ENABLED,
            Cia402State.QUICK_STOP_ACTIVE,
            Cia402State.SWITCHED_ON,
        }
        if code:
            self.fail(code)
        elif live:
            self.machine.disable_voltage()
            self._control()

    def restarted(self, now: float) -> None:
        """Start the drive anew: torque off, state machine at its start, position zero, no faults."""
        self.life.run(now)
        self.motor.disable()
        self.machine = Cia402Machine()
        self._zero = self.motor.position
        self.objects.put(0x1001, 0, 0)
        self.objects.put(0x1003, 0, 0)

    # -- inside -----------------------------------------------------------------------------------------------------

    def _command(self, word: int, now: float) -> None:
        self.machine.quick_stop_holds = self._quick_stop_holds()
        if self.machine.command(word, now):
            self.objects.put(0x1001, 0, 0)
            if (0x603F, 0) in self.objects.entries:
                self.objects.put(0x603F, 0, 0)
            self.node.emergency(0)
        self._control()

    def _quick_stop_holds(self) -> bool:
        return (0x605A, 0) not in self.objects.entries or self.objects.get(0x605A) >= 5

    def _control(self) -> None:
        """Set the motor's demand law from state, set-point and limits."""
        state = self.machine.state
        if state is Cia402State.QUICK_STOP_ACTIVE:
            self.motor.follow(Impedance(kd=1e-3, ceiling=self._ceiling()))
            return
        if state is not Cia402State.OPERATION_ENABLED:
            if self.motor.enabled:
                self.motor.disable()
            return
        if not self.motor.enabled:
            self.motor.enable()
        wanted = self._wanted()
        ceiling = self._ceiling()
        unit = self._speed_unit() if self.kind == "epos4" else TURN / 60.0
        fast = abs(self.motor.velocity) > self.objects.get(*self.model.speed) * unit
        if fast and wanted * self.motor.velocity > 0.0:
            ceiling = 0.0
        self.machine.limiting = abs(wanted) > ceiling
        self.motor.follow(Impedance(feedforward=max(-ceiling, min(ceiling, wanted))))

    def _wanted(self) -> float:
        """Return the torque that the set-point commands, N m; 0 in another mode."""
        if self.objects.get(0x6060) != self.model.mode:
            return 0.0
        value = self.objects.get(*self.model.target)
        return value * (1e-3 * TORQUE_CONSTANT if self.kind == "epos2" else 1e-3 * self._rated())

    def _ceiling(self) -> float:
        """Return the torque that the current limit or torque limit allows, N m."""
        if self.model.current_limit is None:
            return self.objects.get(0x6072) * 1e-3 * self._rated()
        return self.objects.get(*self.model.current_limit) * 1e-3 * self._constant()

    def _constant(self) -> float:
        """Return the torque constant that is set in the drive, N m/A. The motor's true constant is
        `TORQUE_CONSTANT`.
        """
        return self.objects.get(0x3001, 5) * 1e-6 if self.kind == "epos4" else TORQUE_CONSTANT

    def _rated(self) -> float:
        """Return the rated torque of object 0x6076, N m."""
        return self._rated_torque() * (1e-6 if self.kind == "epos4" else 1e-3)

    def _rated_torque(self) -> int:
        if self.kind != "epos4":
            return int(self.objects.values[0x6076, 0])
        return round(self.objects.get(0x3001, 1) * self.objects.get(0x3001, 5) * 1e-3)

    def _speed_unit(self) -> float:
        """Return the velocity in one count, rad/s."""
        prefix = 0
        if (0x60A9, 0) in self.objects.entries:
            prefix = self.objects.get(0x60A9) >> 24
            prefix -= 256 if prefix > 127 else 0
        return float(TURN / 60.0 * 10.0**prefix)

    def _hook(self) -> None:
        """Connect each object that shows or changes the drive's state to its function."""
        counts = 4 * self.objects.get(0x2210, 1) if self.kind == "epos2" else 0
        counts = counts or self.objects.get(*((0x3000, 5) if self.kind == "epos4" else (0x608F, 1)))
        motor = self.motor
        reads = {
            (0x6041, 0): self._statusword,
            (0x6064, 0): lambda: round((motor.position - self._zero) / TURN * counts),
            (0x606C, 0): lambda: round(motor.velocity / self._speed_unit()),
            (0x6077, 0): lambda: round(motor.torque / self._rated() * 1e3) if self._rated() else 0,
            (0x6078, 0): self._milliamperes,
            (0x2027, 0): self._milliamperes,
            (0x2028, 0): lambda: round(motor.velocity / self._speed_unit()),
            (0x30D0, 0): lambda: round(motor.demand / TORQUE_CONSTANT * 1e3),
            (0x30D1, 1): self._milliamperes,
            (0x30D1, 2): self._milliamperes,
            (0x3201, 1): lambda: round(motor.temperature * 10.0),
        }
        if self.kind == "epos4":
            reads[0x6076, 0] = self._rated_torque
        self.objects.read_hooks = {key: hook for key, hook in reads.items() if key in self.objects.entries}
        self.objects.write_hooks |= {
            0x1003: self._history_written,
            0x1010: self._stored,
            0x1011: self._restored,
            0x6040: lambda _i, _s, value: self._command(value, self.life.now),
            0x6060: self._mode_written,
        }

    def _statusword(self) -> int:
        """Return the statusword, 0x6041. An EPOS2 has additional bits: Firmware Specification, April 2010, 8.1.1 and
        Table 101.

        The states of an EPOS2 have the pattern x0xx xxx1 x... ...., where bit 4 is set from "power stage on": 0x140,
        0x121, 0x123, 0x137, 0x117 and 0x108 (compared with the states that the clients EPOS_Canopen and libEPOS
        recognise by that table).
        """
        word = self.machine.statusword
        if self.kind != "epos2":
            return word
        word |= _OFFSET_MEASURED
        if self.node.state != OPERATIONAL:
            word &= ~REMOTE
        if self.machine.state is Cia402State.SWITCHED_ON:
            word &= ~VOLTAGE  # it comes with the power stage
        return word

    def _milliamperes(self) -> int:
        return round(self.motor.torque / TORQUE_CONSTANT * 1e3)

    def _mode_written(self, _index: int, _sub: int, value: int) -> None:
        if value not in {self.model.mode, _DELIVERED}:
            raise Abort(RANGE)
        self.objects.put(0x6061, 0, value)

    def _history_written(self, _index: int, _sub: int, value: int) -> None:
        if value:
            raise Abort(RANGE)

    def _stored(self, _index: int, _sub: int, value: int) -> None:
        if value != _SAVE:
            raise Abort(BAD_SIGNATURE)
        self.node.saved = dict(self.objects.values)

    def _restored(self, _index: int, _sub: int, value: int) -> None:
        """Restore the values as delivered. They take effect at the next reset."""
        if value != _LOAD:
            raise Abort(BAD_SIGNATURE)
        delivered = {key: entry.default for key, entry in self.objects.entries.items()}
        identity = {key: self.objects.values[key] for key in delivered if key[0] in {0x1008, 0x1018, 0x6502}}
        self.node.saved = delivered | identity


def _mode_bit(mode: int) -> int:
    """Return the bit of 0x6502 for a mode: bits 0 to 15 are the modes of CiA 402, bits from 16 on the manufacturer's
    modes, which are negative.
    """
    return 1 << (mode - 1 if mode > 0 else 15 - mode)
