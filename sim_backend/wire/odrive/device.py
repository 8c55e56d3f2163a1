"""An emulated ODrive axis on a CAN bus, which speaks CANSimple. The plant is attached to its motor.

Source: the vendor's CAN protocol page and DBC files for 0.5.6 and 0.6.10, the 0.5.6 firmware's can_simple.cpp and
controller.cpp, and can_enumerate.py of the vendor's ODriveResources. The following is not in these sources and is
assumed here. A boot takes 0.5 s. The motor does not turn in a calibration. The configuration counts as saved. An axis
without a node id sends only its address, on request, within 50 ms. With firmware 0.6, set-points and state requests
feed the watchdog (the vendor's watchdog example sends both), and the watchdog acts only in closed loop. One count of
the current sensor is 20 mA. Position and velocity control are cascades of plain gains without the firmware's
integrator. A set-point or position that is not finite is ignored.
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.canbus.impedance import CanMotor, Impedance
from sim_backend.wire.default_joint import fitting_joint
from sim_backend.wire.life import Life
from sim_backend.wire.odrive.endpoints import Endpoints
from sim_backend.wire.odrive.states import (
    CLOSED_LOOP,
    DISARMED,
    IDLE,
    INVALID_STATE,
    NO_ENDSTOP,
    NOT_CALIBRATED,
    Procedures,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from sim_backend.parameters import SimParameters

TORQUE_CONTROL, VELOCITY_CONTROL, POSITION_CONTROL = 1, 2, 3
BROADCAST = 0x3F
"""The node id that addresses every drive with firmware 0.6, which is also the id of a drive without a node id."""
_ESTOP, _ADDRESS, _REBOOT, _CLEAR = 0x02, 0x06, 0x16, 0x18
BOOT = 0.5
TURN = 2.0 * math.pi
COUNTS = 16384
"""Encoder counts in one turn."""
CURRENT_LSB = 0.02
"""A in one count of current."""
TORQUE_CONSTANT = 0.04
"""N m/A of the emulated motor."""

WATCHDOG = {"0.5": 0x800, "0.6": 0x1000000}
OVERSPEED = {"0.5": 0x200, "0.6": 0x8000}
OVERHEAT = {"0.5": 0x40000, "0.6": 0x2000}
ESTOP = {"0.5": 0x4000, "0.6": 0x2000000}
DRIVER_FAULT = {"0.5": 0x40, "0.6": 0x20}
_INVALID_STATE, _WITHOUT_ENDSTOP = 0x1, 0x20000  # of 0.5.6
"""Bits of the error word, by message layout of the firmware."""

_CYCLIC = {"heartbeat": 0x01, "encoder": 0x09, "torques": 0x1C}
"""The cyclic messages, by their names in the configuration."""
_NODE_ID, _REQUEST = "axis0.config.can.node_id", "axis0.requested_state"
_FLOATS = struct.Struct("<ff")
_INPUT_POS = struct.Struct("<fhh")


class OdriveDevice:
    """An emulated axis with node id `ident` and firmware `firmware`, 0.5.6 or 0.6.x. Times are s on the bus's clock.

    serial: serial number, 48 bits.
    """

    def __init__(
        self,
        ident: int = 0,
        *,
        firmware: str = "0.6.10",
        parameters: SimParameters | None = None,
        now: float = 0.0,
        serial: int = 0x3A5B12,
    ) -> None:
        self.firmware = firmware
        self.layout = "0.5" if firmware.startswith("0.5") else "0.6"
        self.endpoints = Endpoints(ident)
        most = self.endpoints.get("axis0.config.motor.current_soft_max") * TORQUE_CONSTANT
        self.motor = CanMotor(parameters or fitting_joint(most, TORQUE_CONSTANT, 0.06), Impedance())
        self.serial = serial
        self.endpoints.put("serial_number", float(serial % (1 << 32)))
        self.state = IDLE
        self.errors = 0
        self.disarm_reason = 0
        self.calibrated = True
        self.life = Life(self.motor, now, self._watched, lambda: self.errors & WATCHDOG[self.layout])
        self._message = self._messages()
        self._start(now)

    def _start(self, now: float) -> None:
        self._next = {"heartbeat": now + 0.01 * (1 + self.ident % 7), "encoder": now + 0.013, "torques": now + 0.017}
        """Time at which each cyclic message is sent next, s."""
        self._introduces = math.inf
        self._torque = self._velocity = 0.0
        self._position = self._offset = 0.0
        self._procedures = Procedures()

    @property
    def ident(self) -> int:
        """The node id."""
        return int(self.endpoints.get(_NODE_ID))

    def _watched(self) -> bool:
        set_ = bool(self.endpoints.get("axis0.config.enable_watchdog"))
        set_ = set_ and self.endpoints.get("axis0.config.watchdog_timeout") > 0.0
        return set_ and (self.layout == "0.5" or self.state == CLOSED_LOOP)

    # -- the node's side of the bus ---------------------------------------------------------------------------------

    def due(self) -> float:
        """Return the time at which the next cyclic message is sent, s."""
        return min(*self._next.values(), self._introduces)

    def unasked(self, now: float) -> list[CanFrame]:
        """Return the cyclic messages that must be sent at `now`."""
        self.advance(now)
        out = []
        for kind, command in _CYCLIC.items():
            if self._next[kind] <= now:
                self._next[kind] += self._period(kind)
                if math.isfinite(self._next[kind]):
                    out.append(self._frame(command, self._message[command]()))
        if self._nameless:
            out = []
        if self._introduces <= now:
            self._introduces = math.inf
            out.append(self._frame(_ADDRESS, self._message[_ADDRESS]()))
        return out if now >= self.life.ready else []

    @property
    def _nameless(self) -> bool:
        """Return whether the axis has no node id yet."""
        return self.layout == "0.6" and self.ident == BROADCAST

    def _period(self, kind: str) -> float:
        """Return the time between two cyclic messages of a kind, s; infinity if the message is switched off."""
        milliseconds = self.endpoints.get(f"axis0.config.can.{kind}_msg_rate_ms")
        return milliseconds * 1e-3 if milliseconds else math.inf

    def advance(self, now: float) -> None:
        """Simulate the motor up to `now` and check for faults."""
        if self.life.lapses(now, self.endpoints.get("axis0.config.watchdog_timeout")):
            self.fail(WATCHDOG[self.layout])
        self.life.run(now)
        if self.state != CLOSED_LOOP:
            self.calibrated |= self._procedures.proceed(now)
            self.state = self._procedures.state
            return
        limit = self.endpoints.get("axis0.controller.config.vel_limit")
        tolerance = self.endpoints.get("axis0.controller.config.vel_limit_tolerance")
        if abs(self.motor.velocity) / TURN > limit * tolerance:
            self.fail(OVERSPEED[self.layout])
        elif self.motor.temperature > self.endpoints.get("axis0.motor.motor_thermistor.config.temp_limit_upper"):
            self.fail(OVERHEAT[self.layout])
        else:
            self._control()

    def reboot(self, now: float) -> None:
        """Lose the RAM and the position, switch the torque off, and do not reply until the boot has ended."""
        self._go_idle()
        self.life.boot(now, BOOT)
        self.errors = self.disarm_reason = 0
        self._start(now)
        self._offset = self.motor.position
        self._next = dict.fromkeys(self._next, self.life.ready)

    def fail(self, bits: int) -> None:
        """Latch the errors `bits` and disarm the axis."""
        self.errors |= bits
        running, self.disarm_reason = self.state != IDLE, bits if self.state != IDLE else self.disarm_reason
        self._go_idle()
        self._procedures.result = DISARMED if running else self._procedures.result

    def handle(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """Return the replies to a frame."""
        mine = {self.ident, BROADCAST} if self.layout == "0.6" else {self.ident}
        if frame.extended or frame.error or frame.ident >> 5 not in mine or now < self.life.ready:
            return []
        command = frame.ident & 0x1F
        self.advance(now)
        if self.layout == "0.5" or command in {0x07, 0x0C, 0x0D, 0x0E}:
            self.life.heard = now
        if command == _ADDRESS and frame.data:
            self._address(frame.data)
            return []
        if frame.remote or not frame.data:
            return self._replied(command, now)
        if command == 0x04 and self.layout == "0.6":
            return self._parameter(frame.data, now)
        data = frame.data.ljust(8, b"\0")
        size = {0x0C: 1, 0x0D: 2, 0x0E: 1, 0x19: self.layout == "0.6"}.get(command, 0)  # floats that are set-points
        if all(map(math.isfinite, _FLOATS.unpack(data)[:size])):
            self._obey(command, data, now)
        return []

    def _replied(self, command: int, now: float) -> list[CanFrame]:
        """Return the reply to a frame without data, and execute it if it is a command without parameters."""
        if command in {_ESTOP, _REBOOT, _CLEAR}:
            self._obey(command, bytes(8), now)
        message = self._message.get(command) if command != _CYCLIC["heartbeat"] else None
        data = None if message is None else message()
        if data is not None and self._nameless:
            # several without an id would all answer with the same identifier
            self._introduces = now + self.serial % 997 * 5e-5 if command == _ADDRESS else self._introduces
            data = None
        return [] if data is None else [self._frame(command, data)]

    def _address(self, data: bytes) -> None:
        """Execute the message that assigns a node id. With firmware 0.6 the axis with the given serial number gets the
        id, and another axis with this id loses it.
        """
        if self.layout == "0.5":
            self.endpoints.put(_NODE_ID, int.from_bytes(data[:4], "little") % (BROADCAST + 1))
        elif len(data) >= 7 and int.from_bytes(data[1:7], "little") == self.serial:
            self.endpoints.put(_NODE_ID, data[0] % (BROADCAST + 1))
        elif len(data) >= 7 and data[0] == self.ident:
            self.endpoints.put(_NODE_ID, BROADCAST)

    def _frame(self, command: int, data: bytes) -> CanFrame:
        return CanFrame(self.ident << 5 | command, data)

    # -- what it is asked -------------------------------------------------------------------------------------------

    def _messages(self) -> dict[int, Callable[[], bytes]]:
        """Return a function for each message of the axis, which returns its data, by command number."""
        floats, motor, modern = _FLOATS.pack, self.motor, self.layout == "0.6"

        def counts() -> int:
            return round(self._turns() * COUNTS)

        def current() -> float:
            return round(motor.torque / TORQUE_CONSTANT / CURRENT_LSB) * CURRENT_LSB

        def power() -> float:
            return 0.06 * current() ** 2 + motor.torque * motor.velocity

        def volts() -> float:
            return self.endpoints.get("vbus_voltage")

        shared = {
            0x03: lambda: struct.pack("<II", self.errors, self.disarm_reason if modern else 0),
            0x09: lambda: floats(counts() / COUNTS, motor.velocity / TURN),
            0x14: lambda: floats(motor.demand / TORQUE_CONSTANT, current()),
            0x17: lambda: floats(volts(), power() / volts()),
        }
        if not modern:

            def heartbeat() -> bytes:  # with faults of motor, encoder, controller
                faults = bool(self.errors & 0x40), 0, 0x80 | bool(self.errors & 0x200)
                return struct.pack("<IBBBB", self.errors, self.state, *faults)

            silent = dict.fromkeys((0x04, 0x05, 0x15, 0x1D), lambda: bytes(8))  # errors without words; no estimator
            return shared | silent | {0x01: heartbeat, 0x0A: lambda: struct.pack("<ii", counts(), counts() % COUNTS)}
        return shared | {
            0x01: lambda: struct.pack("<IBBBB", self.errors, self.state, self._procedures.result, 1, 0),
            0x00: lambda: bytes([2, 5, 2, 0, *(int(part) for part in self.firmware.split(".")), 0]),
            _ADDRESS: lambda: bytes([self.ident]) + self.serial.to_bytes(6, "little") + b"\0",
            0x15: lambda: floats(motor.temperature, motor.temperature),
            0x1C: lambda: floats(motor.demand, current() * TORQUE_CONSTANT),
            0x1D: lambda: floats(power(), motor.torque * motor.velocity),
        }

    def _turns(self) -> float:
        return (self.motor.position - self._offset) / TURN

    def _parameter(self, data: bytes, now: float) -> list[CanFrame]:
        """Execute RxSdo: read or write an endpoint. Firmware 0.6.11 and later confirms a write."""
        values = {"active_errors": self.errors, "disarm_reason": self.disarm_reason, "current_state": self.state}
        for name, value in (values | {"procedure_result": self._procedures.result}).items():
            self.endpoints.put(f"axis0.{name}", value)
        reply = self.endpoints.sdo(data, confirms=int(self.firmware.split(".")[2]) >= 11)
        if requested := int(self.endpoints.get(_REQUEST)):
            self.endpoints.put(_REQUEST, 0)
            self._request_state(requested)
        for kind in self._next:  # a period may have been changed
            self._next[kind] = min(self._next[kind], now + self._period(kind))
        return [] if reply is None else [self._frame(0x05, reply)]

    # -- commands ------------------------------------------------------------------------------------------------------

    def _obey(self, command: int, data: bytes, now: float) -> None:
        (first, second), words = _FLOATS.unpack(data), struct.unpack("<II", data)
        match command:
            case 0x02:
                self.fail(ESTOP[self.layout])
            case 0x07:
                self._request_state(words[0])
            case 0x0C:
                self._position, velocity, torque = _INPUT_POS.unpack(data)
                self._velocity, self._torque = velocity * 1e-3, torque * 1e-3
            case 0x0D:
                self._velocity, self._torque = first, second
            case 0x0E:
                self._torque = first
            case 0x16:
                if data[0] == 2 and self.layout == "0.6":
                    self.endpoints.erase()
                self.reboot(now)
            case 0x18:
                self.errors = self.disarm_reason = 0
            case _:
                self._configured(command, first, second, words)
        if self.state == CLOSED_LOOP:
            self._control()

    def _configured(self, command: int, first: float, second: float, words: tuple[int, int]) -> None:
        """Execute a command that changes the configuration. first, second: the frame's data decoded as two floats.
        words: the same data decoded as two integers.
        """
        controller = "axis0.controller.config."
        changes: dict[int, dict[str, float]] = {
            0x0B: {controller + "control_mode": words[0], controller + "input_mode": words[1]},
            0x0F: {controller + "vel_limit": first, "axis0.config.motor.current_soft_max": second},
            0x1A: {controller + "pos_gain": first},
            0x1B: {controller + "vel_gain": first, controller + "vel_integrator_gain": second},
            0x11: {"axis0.trap_traj.config.vel_limit": first},
            0x12: {"axis0.trap_traj.config.accel_limit": first, "axis0.trap_traj.config.decel_limit": second},
            0x13: {controller + "inertia": first},
        }
        for name, value in changes.get(command, {}).items():
            self.endpoints.put(name, value)
        if command == 0x0B:
            self._position = self._turns()  # so that a change of mode moves nothing
        if command == 0x19:  # the position in turns, or in counts
            turns = first if self.layout == "0.6" else (words[0] - (words[0] >> 31 << 32)) / COUNTS
            self._offset = self.motor.position - turns * TURN

    def _request_state(self, state: int) -> None:
        """End the present procedure and begin `state`; 0 requests nothing."""
        if state == 0 or (state == IDLE and self.life.ignores_off):
            return
        old = self.layout == "0.5"
        self.errors &= ~_INVALID_STATE if old else ~0
        self.motor.disable()
        self._procedures.begin(state, self.life.now, calibrated=self.calibrated)
        self.state = self._procedures.state
        if state == CLOSED_LOOP and (self.errors or not self.calibrated):
            self._procedures.result = NOT_CALIBRATED if not self.calibrated else DISARMED
        elif state == CLOSED_LOOP:
            self._position = self._turns()
            self.state = CLOSED_LOOP
            self.motor.enable()
            self._control()
        if old and self._procedures.result in {DISARMED, NO_ENDSTOP, INVALID_STATE, NOT_CALIBRATED}:
            self.errors |= _WITHOUT_ENDSTOP if self._procedures.result == NO_ENDSTOP else _INVALID_STATE

    def _go_idle(self) -> None:
        self.state = IDLE
        self._procedures = Procedures()
        self.motor.disable()

    def _control(self) -> None:
        """Set the motor's demand law: cascades in position and velocity control, limits in every mode."""
        get = self.endpoints.get
        mode = int(get("axis0.controller.config.control_mode"))
        ceiling = get("axis0.config.motor.current_soft_max") * TORQUE_CONSTANT
        high = min(ceiling, get("axis0.config.torque_soft_max"))
        low = max(-ceiling, get("axis0.config.torque_soft_min"))
        gain, speed = get("axis0.controller.config.vel_gain"), get("axis0.controller.config.vel_limit")
        if mode == TORQUE_CONTROL:
            wanted = self._torque
            if get("axis0.controller.config.enable_torque_mode_vel_limit"):
                velocity = self.motor.velocity / TURN
                wanted = min(max(wanted, (-speed - velocity) * gain), (speed - velocity) * gain)
            self.motor.follow(Impedance(feedforward=min(max(wanted, low), high)))
            return
        damping = gain / TURN
        stiffness = get("axis0.controller.config.pos_gain") * damping if mode == POSITION_CONTROL else 0.0
        position, velocity = self._position * TURN + self._offset, self._velocity * TURN
        self.motor.follow(
            Impedance(
                self._torque,
                stiffness,
                damping,
                position,
                velocity,
                ceiling=max(0.0, min(high, -low)),
                fastest=speed * TURN if damping > 0.0 else math.inf,
            )
        )
