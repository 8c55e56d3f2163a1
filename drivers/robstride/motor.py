"""Send requests to one RobStride motor, and find its replies among the received frames."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Hashable
from functools import partial
from typing import TYPE_CHECKING

from drivers.canbus.link import frame
from drivers.canbus.requests import LATE, SECOND_REPLY, Requests, garbled
from drivers.retry import retry
from drivers.robstride import frames as wire
from drivers.robstride.frames import Codec, RobstrideState
from drivers.servo import BadReply, DeviceFault, DriverError, NoReply
from drivers.settings import Settings

if TYPE_CHECKING:
    import can

    from drivers.canbus.link import CanLink
    from drivers.clock import Clock
    from drivers.robstride.config import RobstrideConfig

_MIT_STOP = bytes([0xFF] * 7 + [0xFD])
_READ_DEVICE_TYPE = bytes([0x40, 0x00, 0x10, 0, 0, 0, 0, 0])


class RobstrideMotor:
    """Requests to one motor. Every method raises NoReply, BadReply, LinkLost.

    codec: has the ranges of the firmware after `identify`. reported: the fault bits of the last fault frame.
    """

    def __init__(self, config: RobstrideConfig, link: CanLink, clock: Clock) -> None:
        self._config, self._link, self._clock = config, link, clock
        self.codec = self._codec(())
        self.requests = Requests(
            link,
            clock,
            name=f"motor {config.id}",
            timeout=config.reply_timeout,
            classify=self._kind,
            on_cyclic=self._reported,
            only_on_request=frozenset({"state"}),
        )
        self.settings: Settings[str, float] = Settings(self.get, self._put, same=partial(math.isclose, rel_tol=1e-6))
        self.reported = 0
        self._other = ""  # the other program that commands the motor
        self._field = 0  # of the last feedback: mode and faults
        self._index: int | None = None  # of the parameter that is read
        self._refused = False

    def drive(self, torque_counts: int) -> RobstrideState:
        """Command a torque of `torque_counts` with both gains zero, and read the state in one round trip."""
        return self._state(self._operation(torque_counts))

    def enable(self) -> RobstrideState:
        """Start the motor: from now on current can flow."""
        return self._state(self._frame(wire.ENABLE))

    def stop(self) -> RobstrideState:
        """Switch the torque off. A latched fault stays."""
        self.requests.unrequested.clear()
        return self._state(self._frame(wire.STOP))

    def look(self) -> RobstrideState:
        """Read and return the state. A current set-point is sent for this, because it has no effect in
        operation mode.
        """
        return self._state(self._written("iq_ref", 0.0))

    def send_stop(self) -> None:
        """Switch the torque off at once, without waiting for the reply."""
        self.requests.send_now([self._frame(wire.STOP)], ["state"])

    def off_frames(self) -> list[can.Message]:
        """Return the frames that switch the torque off: zero torque, then stop."""
        return [self._operation(self.codec.torque.of(0.0)), self._frame(wire.STOP)]

    def restoring(self) -> list[can.Message]:
        """Return the frames that restore the parameters that were changed."""
        return [self._written(name, value) for name, value in self.settings.changed()]

    def identify(self) -> tuple[str, tuple[int, ...]]:
        """Switch the torque and the cyclic reports off, and check that the motor is the model of the stand file.

        Returns its serial number and its firmware version, () if it reports no version. Raises NoReply if no motor
        replies, BadReply if several reply, DriverError for another model or another protocol, DeviceFault if another
        host commands it.
        """
        self.requests.send_now([self._frame(wire.STOP), self._frame(wire.REPORTING, wire.REPORT_NOTHING)], ["state"])
        self.requests.wait_until(SECOND_REPLY, lambda: False)
        try:
            retry(self.stop)
            self.requests.check_alone("state")
            serial = self.requests.ask([self._frame(wire.IDENTITY)], ["identity"])["identity"]
        except (NoReply, BadReply) as error:
            raise self._no_reply(error) from None
        version = self._version()
        self._check_model(version)
        self.codec = self._codec(version)
        self.requests.wait_until(LATE, lambda: False)
        self.check_host()
        return serial.hex(), version

    def forget(self) -> None:
        """Forget the last fault frame and another program's frames. A fault or program that persists will be noticed
        again.
        """
        self.reported, self._other = 0, ""

    def check_host(self) -> None:
        """Raise DeviceFault if another program on the bus sent the motor a command, or received its reply."""
        if self._other:
            words = f"another program ({self._other}) commands motor {self._config.id} too, so that its"
            raise DeviceFault(wire.OTHER_HOST, f"{words} torque is not ours: end that program, or use another bus")

    def get(self, name: str) -> float:
        """Return the value of a parameter. Raises DriverError if the motor does not have it."""
        index, layout = wire.parameters()[name]
        asked = self._frame(wire.READ, index.to_bytes(2, "little") + bytes(6))
        self._index, self._refused = index, False
        try:
            data = retry(lambda: self.requests.ask([asked], ["parameter"])["parameter"])
        finally:
            self._index = None
        if self._refused:
            raise DriverError(f"the motor has no parameter {name} (0x{index:04X}): update its firmware")
        value = float(layout.unpack_from(data, 4)[0]) if len(data) == 8 else math.nan
        if not math.isfinite(value):
            raise BadReply(f"the motor reports no number in {name}: restore its parameters with the maker's tool")
        return value

    def _put(self, name: str, value: float) -> None:
        self._state(self._written(name, value))

    def _written(self, name: str, value: float) -> can.Message:
        index, layout = wire.parameters()[name]
        raw = layout.pack(value if layout.format == "<f" else int(value))
        return self._frame(wire.WRITE, (index.to_bytes(2, "little") + bytes(2) + raw).ljust(8, b"\0"))

    def _frame(self, kind: int, data: bytes = bytes(8)) -> can.Message:
        return frame(wire.identifier(kind, self._config.host_id, self._config.id), data, extended=True)

    def _operation(self, torque_counts: int) -> can.Message:
        rest = (0x8000).to_bytes(2, "big")  # angle and velocity, which the gains of zero make meaningless
        ident = wire.identifier(wire.OPERATE, torque_counts, self._config.id)
        return frame(ident, rest + rest + bytes(4), extended=True)

    def _codec(self, version: tuple[int, ...]) -> Codec:
        config, model = self._config, wire.models()[self._config.model]
        return Codec(
            config.position_range or wire.position_range(version),
            config.velocity_range or model.velocity,
            config.torque_range or model.torque,
        )

    def _state(self, message: can.Message) -> RobstrideState:
        self.requests.refuse_unrequested()
        data = self.requests.ask([message], ["state"])["state"]
        return self.codec.state(self._field, data)

    def _version(self) -> tuple[int, ...]:
        """Return the firmware's version; () for firmware without this request, which it treats as a stop."""
        try:
            data = retry(lambda: self.requests.ask([self._frame(wire.STOP, wire.ASK_VERSION)], ["version"])["version"])
        except NoReply:
            self.requests.unrequested.clear()
            return ()
        return tuple(data[3:7])

    def _check_model(self, version: tuple[int, ...]) -> None:
        """Raise DriverError if the firmware belongs to another model: its torque range would scale the torque, and Kc,
        wrongly.
        """
        config, line = self._config, wire.models()[self._config.model].line
        if version and line and version[: len(line)] != line and config.torque_range is None:
            raise DriverError(
                f"motor {config.id} has firmware {'.'.join(map(str, version))}, and that of an {config.model} begins "
                f"with {'.'.join(map(str, line))}: the range of its torque, and with it Kc, would be wrong; correct "
                "robstride.model or robstride.id, or set robstride.torque_range and velocity_range to the motor's"
            )
        if not version and config.model == "rs00" and config.position_range is None:
            raise DriverError(
                f"motor {config.id} does not report its firmware, on which the range of its angle depends: set "
                "robstride.position_range to 12.5 rad (before 0.0.2.6) or 12.566"
            )

    def _kind(self, message: can.Message) -> Hashable | None:
        """Return the kind of a reply of the motor, and store the data in its identifier."""
        if not message.is_extended_id or message.is_remote_frame:
            return None
        kind, field, to = wire.parts(message.arbitration_id)
        sender, ident, found = field & 0xFF, self._config.id, None
        if kind == wire.FAULT and ident in {sender, to}:
            found = "fault"
        elif to == ident and (kind in wire.COMMANDS or kind == wire.OPERATE):
            self._note_other(kind, field)
        elif kind == wire.IDENTITY and (sender, to) == (ident, wire.BROADCAST):
            found = "identity"
        elif sender != ident or kind not in {wire.FEEDBACK, wire.READ}:
            pass
        elif to != self._config.host_id:
            self._other = f"host id {to}"
        elif kind == wire.FEEDBACK:
            self._field = field
            found = "version" if bytes(message.data[:3]) == wire.VERSION else "state"
        elif self._index is not None and (field > 0xFF or int.from_bytes(message.data[:2], "little") == self._index):
            self._refused = field > 0xFF  # the data of a refusal are zero
            found = "parameter"
        return found

    def _note_other(self, kind: int, field: int) -> None:
        """Note a command of another program. The guardian's commands have our id, or zero torque in frames without an
        id.
        """
        if kind == wire.OPERATE and field != self.codec.torque.of(0.0):
            self._other = "its set-points carry no host id"
        elif kind != wire.OPERATE and field & 0xFF != self._config.host_id:
            self._other = f"host id {field & 0xFF}"

    def _reported(self, kind: Hashable, data: bytes) -> None:
        if kind == "fault" and len(data) >= 4:
            self.reported = int.from_bytes(data[:4], "little")

    def _no_reply(self, error: DriverError) -> DriverError:
        if isinstance(error, BadReply) or self._link.error_frames:
            return garbled(self.requests.name, str(error))
        if protocol := self._other_protocol():
            return DriverError(f"motor {self._config.id} {protocol}, then switch its power off and on")
        return NoReply(
            f"no motor {self._config.id} answers on {self._link.name} at {self._config.bitrate} bit/s: check its "
            "power, the wiring and its termination, the id, the bit rate (1000000 as delivered), and its protocol"
        )

    def _other_protocol(self) -> str:
        """Return the remedy for a motor that uses MIT frames or CANopen; "" if no such motor replies.

        An MIT stop and the request for a CANopen device type change nothing in a motor whose torque is off.
        """
        ident = self._config.id
        remedy = "set the private protocol in the maker's tool, or send it"
        for asked in (frame(ident, _MIT_STOP), frame(0x600 + ident, _READ_DEVICE_TYPE)):
            self._link.send(asked)
            deadline = self._clock.now() + self._config.reply_timeout
            with contextlib.suppress(BadReply):
                while (reply := self._link.receive(deadline)) is not None:
                    if not reply.is_extended_id and reply.arbitration_id == 0x580 + ident:
                        return f"speaks CANopen: {remedy} the extended frame 00000FFF#0102030405060000"
                    if not reply.is_extended_id and reply.arbitration_id <= 0xFF and reply.data[:1] == bytes([ident]):
                        words = "speaks MIT frames: an AK or a Damiao needs backend = 'mit'; of a RobStride,"
                        return f"{words} {remedy} the frame {ident:03X}#FFFFFFFFFFFF00FD"
        return ""
