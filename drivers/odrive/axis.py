"""One ODrive axis on the bus: its firmware version, its heartbeats, and its temperature and voltage, which change
slowly.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Hashable
from typing import TYPE_CHECKING

from drivers.canbus.neighbours import listen
from drivers.canbus.requests import Requests, garbled
from drivers.gate import CONFIRMS
from drivers.neighbours import Neighbour
from drivers.odrive.messages import COMMAND_BITS, IDLE, Codec
from drivers.retry import retry
from drivers.servo import BadReply, DriverError, NoReply

if TYPE_CHECKING:
    import can

    from drivers.canbus.link import CanLink
    from drivers.clock import Clock
    from drivers.odrive.config import OdriveConfig

_SLOWEST = 2.5
"""s to wait for a heartbeat, whose period a user may change; it is 0.1 s in a new drive."""
_FASTER = "set its period to 0.1 s, heartbeat_msg_rate_ms = 100 (firmware 0.5: heartbeat_rate_ms), with odrivetool"
_SHORTEST = 0.35
"""s for which a heartbeat is waited for at least, however short its period."""
_CYCLE = 0.12
"""s to wait for a cyclic message of torque or current: if the drive sends any, one arrives within this time."""

_NEIGHBOURS = 1.0
"""s for which other axes' heartbeats are listened to; their period is 0.1 s in a new drive."""
_HEARTBEAT, _SET_STATE = 0x01, 0x07  # command numbers in every firmware: table.toml


class Axis:
    """One ODrive axis on the bus.

    state, errors: from the last heartbeat. beats: number of heartbeats received. patience: s within which the next
    heartbeat must arrive, from its period as measured when the axis was identified. temperature: degC, voltage: V, both
    NaN until known.
    """

    def __init__(self, config: OdriveConfig, link: CanLink, clock: Clock) -> None:
        self._config = config
        self._link = link
        self._clock = clock
        self.patience = _SLOWEST
        self.codec = Codec(config.id, "0.6")
        self.requests = Requests(
            link,
            clock,
            name=f"ODrive axis {config.id}",
            timeout=config.reply_timeout,
            classify=self._kind,
            on_cyclic=self._on_cyclic,
            only_on_request=frozenset({"version", "torques", "iq"}),
        )
        self.state = self.errors = self.beats = 0
        self.temperature = self.voltage = math.nan

    def identify(self) -> str:
        """Return the firmware version of the axis. Its message layout is used from then on.

        Raises NoReply if no axis replies, BadReply if several axes reply, DriverError for an unknown firmware.
        """
        version = self._version()
        if version is None:
            self.codec = Codec(self._config.id, "0.5")
        elif version < (0, 6):
            raise DriverError(f"firmware {_dotted(version)} is not known here: update it to 0.5.6 or 0.6")
        both = [self.codec.request("encoder"), self.codec.request("iq")]
        try:
            retry(lambda: self.requests.ask(both, ["encoder", "iq"]), (NoReply,))
        except NoReply:
            raise self._no_reply() from None
        if self._link.error_frames:
            raise garbled(self.requests.name, f"{self._link.error_frames} error frames on the bus")
        self._measure_period()
        if self.requests.wait_until(_CYCLE, lambda: bool(self.requests.unrequested)):
            if version is None:
                raise garbled(self.requests.name, "it answers twice")
            self.requests.only_on_request = frozenset()  # cyclic messages of torque or current are switched on
            self.requests.unrequested.clear()
        return "0.5" if version is None else _dotted(version)

    def await_heartbeat(self) -> None:
        """Wait for the next heartbeat. Raises NoReply."""
        self.requests.process()
        beats = self.beats
        if not self.requests.wait_until(self.patience, lambda: self.beats > beats):
            raise NoReply(
                f"ODrive axis {self._config.id} answers, but sends no heartbeat within {self.patience:.3g} s, and only "
                f"the heartbeat tells its state: {_FASTER}"
            )

    def neighbours(self) -> list[Neighbour]:
        """Return the other axes that a heartbeat shows in another state than idle. Nothing is sent. Raises LinkLost."""
        states: dict[int, int] = {}

        def take(message: can.Message) -> None:
            ident, number = divmod(message.arbitration_id, 1 << COMMAND_BITS)
            data = bytes(message.data)
            if number == _HEARTBEAT and ident != self._config.id and len(data) == 8 and not message.is_extended_id:
                states[ident] = data[4]

        listen(self._link, self._clock, _NEIGHBOURS, take)
        return [
            Neighbour(
                ident,
                "an ODrive axis",
                f"its heartbeat reports the state {state}, and 1 is idle",
                f"request its state idle, with the frame {ident << COMMAND_BITS | _SET_STATE:03X}#01000000",
            )
            for ident, state in sorted(states.items())
            if state > IDLE
        ]

    def _measure_period(self) -> None:
        self.await_heartbeat()
        begin = self._clock.now()
        self.await_heartbeat()
        period = self._clock.now() - begin
        if period > CONFIRMS:
            raise DriverError(
                f"ODrive axis {self._config.id} sends a heartbeat every {period:.2g} s. Only this confirms that "
                f"the torque is off, which must take at most {CONFIRMS:g} s: {_FASTER}"
            )
        self.patience = max(_SHORTEST, 1.5 * period)

    def _version(self) -> tuple[int, ...] | None:
        """Return the firmware version by Get_Version; None if there is no reply, as with firmware 0.5."""
        try:
            replies = retry(lambda: self.requests.ask([self.codec.request("version")], ["version"]), (NoReply,))
        except NoReply:
            return None
        self.requests.check_alone("version")
        version: tuple[int, ...] = self.codec.decoded("version", replies["version"])[4:7]
        return version

    def _kind(self, message: can.Message) -> Hashable | None:
        return self.codec.name_of(
            message.arbitration_id, extended=message.is_extended_id, remote=message.is_remote_frame
        )

    def _on_cyclic(self, kind: Hashable, data: bytes) -> None:
        """Store a cyclic message, or a reply about a slowly changing value (temperature, voltage, errors)."""
        with contextlib.suppress(BadReply):
            if kind == "heartbeat":
                self.errors, self.state, *_ = self.codec.decoded("heartbeat", data)
                self.beats += 1
            elif kind == "temperature":
                known = [value for value in self.codec.decoded("temperature", data) if math.isfinite(value)]
                self.temperature = max(known, default=math.nan)
            elif kind == "bus":
                self.voltage, _ = self.codec.decoded("bus", data)
            elif kind == "error":
                self.errors, _ = self.codec.decoded("error", data)

    def _no_reply(self) -> DriverError:
        if self._link.error_frames:
            return garbled(self.requests.name, f"{self._link.error_frames} error frames on the bus")
        return NoReply(
            f"no ODrive axis {self._config.id} answers on {self._link.name} at {self._config.bitrate} bit/s: check "
            "its power, the wiring and its termination, the node id (the identifier of its heartbeat divided by 32), "
            "and the bit rate (250000 in a new drive)"
        )


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(str(number) for number in version)
