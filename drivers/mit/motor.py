"""One motor on the bus that speaks MIT frames: what is sent to it and what of all that arrives is its answer."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING

from drivers.canbus.link import frame
from drivers.canbus.requests import Requests
from drivers.mit.frames import (
    CLEAR,
    ENTER,
    LEAVE,
    READ,
    REFRESH,
    REGISTERS_ID,
    WRITE,
    Codec,
    State,
    models,
    registers,
)
from drivers.servo import BadReply, DriverError, NoReply

if TYPE_CHECKING:
    import can

    from drivers.canbus.link import CanLink
    from drivers.clock import Clock
    from drivers.mit.config import MitConfig

_TRIES = 3
_SECOND_ANSWER = 0.004
"""s in which a second motor with the same id would have answered."""


class MitMotor:
    """The conversation with one motor. Every method raises what `Requests.ask` does."""

    def __init__(self, config: MitConfig, link: CanLink, clock: Clock) -> None:
        self._config = config
        self._link = link
        self.codec = Codec(models()[config.model].family, *config.ranges)
        self._requests = Requests(
            link,
            clock,
            name=f"motor {config.id}",
            timeout=config.reply_timeout,
            classify=self._kind,
            overhear=lambda _kind, _data: None,
            only_asked=frozenset({"state"}),
        )
        self._register: int | None = None
        self._found: dict[str, float] = {}

    @property
    def damiao(self) -> bool:
        """Whether it has registers and says whether it is enabled."""
        return self.codec.family == "damiao"

    def drive(self, counts: int) -> State:
        """Command a torque of `counts` and read the state in one round trip."""
        return self._state(frame(self._config.id, self.codec.command(counts)))

    def look(self) -> State:
        """The state of a motor that is not to be driven: a Damiao is asked; an AK, which answers frames only, is told
        to leave motor mode once more.
        """
        if self.damiao:
            return self._state(frame(REGISTERS_ID, self._registers_head(REFRESH) + bytes(5)))
        return self.leave()

    def enter(self) -> State:
        """Let current flow."""
        return self._state(frame(self._config.id, ENTER))

    def leave(self) -> State:
        """Torque off."""
        self._requests.unasked.clear()
        return self._state(frame(self._config.id, LEAVE))

    def clear(self) -> None:
        """Clear a Damiao's error."""
        self._state(frame(self._config.id, CLEAR))

    def send_leave(self) -> None:
        """Torque off at once, without waiting for an answer."""
        self._requests.fire([frame(self._config.id, LEAVE)], ["state"])

    def identify(self) -> str:
        """Switch it off, make sure that it is alone and what the stand file says; the firmware, where it says so.

        Raises NoReply where nobody answers, BadReply where several do, DriverError for another motor.
        """
        for attempt in range(_TRIES):
            try:
                self.leave()
                break
            except (NoReply, BadReply) as error:
                if attempt == _TRIES - 1:
                    raise self._nobody(error) from None
        if self._requests.await_change(_SECOND_ANSWER, lambda: bool(self._requests.unasked)):
            raise BadReply(self._garbled("it answers twice"))
        if not self.damiao:
            return ""
        for name, expected in zip(
            ("position_range", "velocity_range", "torque_range"), self._config.ranges, strict=True
        ):
            found = self.get(name)
            if abs(found - expected) > 1e-3 * expected:
                raise DriverError(
                    f"motor {self._config.id} says its {name} is {found:g}, and [mit] means {expected:g} for the "
                    f"{self._config.model}: correct mit.model or mit.id, or set mit.{name} to what the motor says"
                )
        return str(int(self.get("software")))

    def get(self, name: str) -> float:
        """A register of a Damiao."""
        register = registers()[name]
        data = self._ask_register(self._registers_head(READ) + bytes([register.number]) + bytes(4), register.number)
        return float(register.layout.unpack_from(data, 4)[0])

    def require(self, name: str, value: float) -> None:
        """Make a register hold `value`, and read it back; what was found is kept for `restore`. It is not stored, so
        that the motor forgets it without power.

        Raises DriverError where the motor keeps another value.
        """
        layout = registers()[name].layout
        exact = float(layout.unpack(self._encoded(name, value))[0])
        found = self.get(name)
        if found == exact:
            return
        self._found.setdefault(name, found)
        self._put(name, value)
        kept = self.get(name)
        if kept != exact:
            raise DriverError(
                f"motor {self._config.id} keeps {kept:g} in {name} where {exact:g} was written: it is not safe to go on"
            )

    def restore(self) -> None:
        """Put the registers back as they were found, as far as the motor lets us."""
        while self._found:
            name, value = self._found.popitem()
            try:
                self._put(name, value)
            except DriverError:
                continue  # one that cannot be put back must not keep the others from it

    def _put(self, name: str, value: float) -> None:
        number = registers()[name].number
        self._ask_register(self._registers_head(WRITE) + bytes([number]) + self._encoded(name, value), number)

    def _encoded(self, name: str, value: float) -> bytes:
        layout = registers()[name].layout
        return layout.pack(value if layout.format == "<f" else int(value))

    def _registers_head(self, command: int) -> bytes:
        return self._config.id.to_bytes(2, "little") + bytes([command])

    def _ask_register(self, data: bytes, number: int) -> bytes:
        self._register = number
        try:
            for attempt in range(_TRIES):
                try:
                    reply = self._requests.ask([frame(REGISTERS_ID, data)], ["register"])["register"]
                except NoReply:
                    if attempt == _TRIES - 1:
                        raise
                    continue
                if len(reply) == 8:
                    return reply
        finally:
            self._register = None
        raise BadReply(f"register {number}: the reply is cut short")

    def _state(self, message: can.Message) -> State:
        self._requests.refuse_unasked()
        return self.codec.state(self._requests.ask([message], ["state"])["state"])

    def _kind(self, message: can.Message) -> Hashable | None:
        data = message.data
        if message.is_extended_id or message.is_remote_frame or message.arbitration_id not in self._config.reply_ids:
            return None
        ident = self._config.id
        if not data:
            return "state"  # cut short to nothing; the decoder says so
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

    def _nobody(self, error: DriverError) -> DriverError:
        if isinstance(error, BadReply) or self._link.error_frames:
            return BadReply(self._garbled(str(error)))
        return NoReply(
            f"no motor {self._config.id} answers on {self._link.name} at {self._config.bitrate} bit/s: check its "
            "power, the wiring and its termination, the id, the bit rate, and mit.reply_id "
            f"(replies with identifier {' or '.join(str(i) for i in sorted(self._config.reply_ids))} are expected)"
        )

    def _garbled(self, reason: str) -> str:
        return (
            f"what answers as motor {self._config.id} cannot be understood ({reason}): two motors with that id, or a "
            "bit rate that is off; connect one motor alone and give each its own id"
        )
