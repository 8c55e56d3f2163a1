"""Send requests to one motor with the MIT protocol, and find its replies among the received frames."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator
from typing import TYPE_CHECKING

from drivers.canbus.link import frame
from drivers.canbus.neighbours import ask_each
from drivers.canbus.requests import Requests, garbled
from drivers.mit.frames import (
    CLEAR,
    ENABLED,
    ENTER,
    LEAVE,
    READ,
    REFRESH,
    REGISTERS_ID,
    SERVO_CURRENT,
    SERVO_REPORT,
    SERVO_REPORTS,
    WRITE,
    Codec,
    MitState,
    models,
    registers,
)
from drivers.neighbours import Neighbour
from drivers.retry import retry
from drivers.servo import BadReply, DriverError, NoReply
from drivers.settings import Settings

if TYPE_CHECKING:
    import can

    from drivers.canbus.link import CanLink
    from drivers.clock import Clock
    from drivers.mit.config import MitConfig

_HIGHEST = 127


class MitMotor:
    """One motor on the bus. Every method raises NoReply, BadReply, LinkLost."""

    def __init__(self, config: MitConfig, link: CanLink, clock: Clock) -> None:
        self._config = config
        self._link, self._clock = link, clock
        self.codec = Codec(models()[config.model].family, *config.ranges)
        self.requests = Requests(
            link,
            clock,
            name=f"motor {config.id}",
            timeout=config.reply_timeout,
            classify=self._kind,
            only_on_request=frozenset({"state"}),
        )
        self._register: int | None = None
        self._servo_mode = False
        self.settings: Settings[str, float] = Settings(self.get, self._put)

    @property
    def damiao(self) -> bool:
        """Return whether the motor is a Damiao: it has registers and reports whether it is enabled."""
        return self.codec.family == "damiao"

    def drive(self, counts: int) -> MitState:
        """Command a torque of `counts` and read the state in one round trip."""
        return self._state(frame(self._config.id, self.codec.command(counts)))

    def look(self) -> MitState:
        """Return the state of a disarmed motor.

        A Damiao has a request for its state. An AK has none, so the frame that leaves motor mode is sent again.
        """
        if self.damiao:
            return self._state(frame(REGISTERS_ID, self._registers_head(REFRESH) + bytes(5)))
        return self.leave()

    def enter(self) -> MitState:
        """Enter motor mode, in which current can flow. Return the state."""
        return self._state(frame(self._config.id, ENTER))

    def leave(self) -> MitState:
        """Leave motor mode, which switches the torque off. Return the state."""
        self.requests.unrequested.clear()
        return self._state(frame(self._config.id, LEAVE))

    def clear(self) -> None:
        """Clear the latched error of a Damiao."""
        self._state(frame(self._config.id, CLEAR))

    def send_leave(self) -> None:
        """Send the frame that leaves motor mode at once, and do not wait for the reply."""
        self.requests.send_now([frame(self._config.id, LEAVE)], ["state"])

    def off_frames(self) -> list[can.Message]:
        """Return the frames that switch the torque off: zero torque, then leaving motor mode."""
        zero = self.codec.command(self.codec.torque.of(0.0))
        return [frame(self._config.id, zero), frame(self._config.id, LEAVE)]

    def restoring(self) -> list[can.Message]:
        """Return the frames that restore the registers that `require` changed."""
        return [frame(REGISTERS_ID, self._written(name, value)) for name, value in self.settings.changed()]

    def identify(self) -> str:
        """Switch the torque off, then check that only one motor replies and that it is the model of the stand file.

        Returns its firmware version, "" if the motor reports none. Raises NoReply if no motor replies, BadReply if
        several motors reply, DriverError for another model.
        """
        try:
            retry(self.leave)
        except (NoReply, BadReply) as error:
            raise self._no_reply(error) from None
        self.requests.check_alone("state")
        if not self.damiao:
            return ""
        for name, expected in zip(
            ("position_range", "velocity_range", "torque_range"), self._config.ranges, strict=True
        ):
            reported = self.get(name)
            if abs(reported - expected) > 1e-3 * expected:
                raise DriverError(
                    f"motor {self._config.id} reports a {name} of {reported:g}, and [mit] has {expected:g} for the "
                    f"{self._config.model}: correct mit.model or mit.id, or set mit.{name} to the motor's value"
                )
        return str(int(self.get("software")))

    def get(self, name: str) -> float:
        """Return the value of a register of a Damiao."""
        register = registers()[name]
        data = self._ask_register(self._registers_head(READ) + bytes([register.number]) + bytes(4), register.number)
        return float(register.layout.unpack_from(data, 4)[0])

    def neighbours(self) -> list[Neighbour] | None:
        """Return the other Damiaos on the bus that are enabled, None for an AK, which reports its state only in reply
        to a command. Only the request for the state is sent. Raises LinkLost, and NoReply if the bus accepts no frame.

        A reply holds four bits of the id, so it belongs to the motor with these bits that was asked last.
        """
        if not self.damiao:
            return None
        last: dict[int, int] = {}
        enabled: set[int] = set()

        def asked(idents: Iterable[int]) -> Iterator[can.Message]:
            for ident in idents:
                last[ident & 0xF] = ident
                yield frame(REGISTERS_ID, ident.to_bytes(2, "little") + bytes([REFRESH]) + bytes(5))

        def take(message: can.Message) -> None:
            data = bytes(message.data)
            if not message.is_extended_id and len(data) == 8 and data[0] >> 4 == ENABLED and data[0] & 0xF in last:
                enabled.add(last[data[0] & 0xF])

        others = [ident for ident in range(1, _HIGHEST + 1) if ident != self._config.id]
        for _ in range(2):  # other frames on the bus may look like a reply once
            last.clear()
            enabled.clear()
            ask_each(self._link, self._clock, self._config.bitrate, asked(others), take)
            others = sorted(enabled)
        release = "disable it, with the frame {:03X}#FFFFFFFFFFFFFFFD"
        return [Neighbour(one, "a Damiao", "it reports that it is enabled", release.format(one)) for one in others]

    def require(self, name: str, value: float) -> None:
        """Write `value` to the register `name` of a Damiao and read it back. The motor loses this value without power.

        Raises DriverError if the drive then holds another value.
        """
        exact = float(registers()[name].layout.unpack(self._encoded(name, value))[0])
        self.settings.require(name, exact)

    def _put(self, name: str, value: float) -> None:
        self._ask_register(self._written(name, value), registers()[name].number)

    def _written(self, name: str, value: float) -> bytes:
        return self._registers_head(WRITE) + bytes([registers()[name].number]) + self._encoded(name, value)

    def _encoded(self, name: str, value: float) -> bytes:
        layout = registers()[name].layout
        return layout.pack(value if layout.format == "<f" else int(value))

    def _registers_head(self, command: int) -> bytes:
        return self._config.id.to_bytes(2, "little") + bytes([command])

    def _ask_register(self, data: bytes, number: int) -> bytes:
        def request() -> bytes:
            reply = self.requests.ask([frame(REGISTERS_ID, data)], ["register"])["register"]
            if len(reply) != 8:
                raise BadReply(f"register {number}: the reply is cut short")
            return reply

        self._register = number
        try:
            return retry(request)
        finally:
            self._register = None

    def _state(self, message: can.Message) -> MitState:
        self.requests.refuse_unrequested()
        return self.codec.state(self.requests.ask([message], ["state"])["state"])

    def _kind(self, message: can.Message) -> Hashable | None:
        data = message.data
        if message.is_extended_id and message.arbitration_id == SERVO_REPORT << 8 | self._config.id:
            self._servo_mode = not self.damiao
        if message.is_extended_id or message.is_remote_frame or message.arbitration_id not in self._config.reply_ids:
            return None
        ident = self._config.id
        if not data:
            return "state"  # without data; the decoder refuses it
        if not self.damiao:
            return "state" if data[0] == ident else None
        if (
            self._register is not None
            and len(data) >= 4
            and (data[0], data[1], data[3]) == (ident & 0xFF, ident >> 8, self._register)
            and data[2] in {READ, WRITE}
        ):
            return "register"
        return "state" if data[0] & 0xF == ident & 0xF else None

    def _no_reply(self, error: DriverError) -> DriverError:
        if isinstance(error, BadReply) or self._link.error_frames:
            return garbled(self.requests.name, str(error))
        if self._is_in_servo_mode():
            return DriverError(
                f"motor {self._config.id} is in servo mode (it sends frames with identifiers of 29 bits), and MIT "
                "frames do nothing: choose MIT mode with the vendor's tool, then switch its power off and on"
            )
        return NoReply(
            f"no motor {self._config.id} answers on {self._link.name} at {self._config.bitrate} bit/s: check its "
            "power, the wiring and its termination, the id, the bit rate, and mit.reply_id "
            f"(replies with identifier {' or '.join(str(i) for i in sorted(self._config.reply_ids))} are expected)"
        )

    def _is_in_servo_mode(self) -> bool:
        """Return whether an AK reports in servo mode. Before it listens, it switches the current of that mode off."""
        if not self.damiao:
            self.requests.send([frame(SERVO_CURRENT << 8 | self._config.id, bytes(4), extended=True)])
            self.requests.wait_until(SERVO_REPORTS, lambda: self._servo_mode)
        return self._servo_mode
