"""One ODrive axis on the bus: who it is, and what it says of itself in heartbeats and late answers."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Hashable
from typing import TYPE_CHECKING

from drivers.canbus.requests import Requests
from drivers.odrive.messages import Codec
from drivers.servo import BadReply, DriverError, NoReply

if TYPE_CHECKING:
    import can

    from drivers.canbus.link import CanLink
    from drivers.clock import Clock
    from drivers.odrive.config import OdriveConfig

HEARTBEAT = 0.6
"""s without a heartbeat after which there is none; the drive's default period is 0.1 s."""
_TRIES = 3
_CYCLE = 0.12
"""s in which a cyclic message of torque or current would have come."""
_SECOND_ANSWER = 0.004
"""s in which a second drive with the same id would have answered."""


class Axis:
    """The conversation with one axis and its last known state.

    state, errors: of the last heartbeat. beats: heartbeats heard. temperature degC, voltage V: NaN until known.
    """

    def __init__(self, config: OdriveConfig, link: CanLink, clock: Clock) -> None:
        self._config = config
        self._link = link
        self.codec = Codec(config.id, "0.6")
        self.requests = Requests(
            link,
            clock,
            name=f"ODrive axis {config.id}",
            timeout=config.reply_timeout,
            classify=self._kind,
            overhear=self._overhear,
            only_asked=frozenset({"version", "torques", "iq"}),
        )
        self.state = self.errors = self.beats = 0
        self.temperature = self.voltage = math.nan

    def identify(self) -> str:
        """Its firmware, whose layout is spoken from then on.

        Raises NoReply where nobody is heard, BadReply where several are, DriverError for a firmware not known here.
        """
        version = self._version()
        if not self.requests.await_change(HEARTBEAT, lambda: self.beats > 0):
            raise NoReply(self._nobody())
        if version is None:
            self.codec = Codec(self._config.id, "0.5")
        elif version < (0, 6):
            raise DriverError(f"firmware {_dotted(version)} is not known here: bring it to 0.5.6 or 0.6")
        for attempt in range(_TRIES):
            try:
                self.requests.ask([self.codec.request("encoder"), self.codec.request("iq")], ["encoder", "iq"])
                break
            except NoReply:
                if attempt == _TRIES - 1:
                    raise NoReply(self._nobody()) from None
        if self._link.error_frames:
            raise BadReply(self._garbled(f"{self._link.error_frames} error frames on the bus"))
        if self.requests.await_change(_CYCLE, lambda: bool(self.requests.unasked)):
            if version is None:
                raise BadReply(self._garbled("it answers twice"))
            self.requests.only_asked = frozenset()  # cyclic messages of torque or current are switched on
            self.requests.unasked.clear()
        return "0.5" if version is None else _dotted(version)

    def hear_a_beat(self) -> None:
        """Wait for the next heartbeat. Raises NoReply."""
        self.requests.listen()
        beats = self.beats
        if not self.requests.await_change(HEARTBEAT, lambda: self.beats > beats):
            raise NoReply(self._nobody())

    def _version(self) -> tuple[int, ...] | None:
        """What Get_Version says; None where it is not answered, as by firmware 0.5."""
        for _ in range(_TRIES):
            try:
                data = self.requests.ask([self.codec.request("version")], ["version"])["version"]
            except NoReply:
                continue
            version: tuple[int, ...] = self.codec.decoded("version", data)[4:7]
            if self.requests.await_change(_SECOND_ANSWER, lambda: "version" in self.requests.unasked):
                raise BadReply(self._garbled("it answers twice"))
            return version
        return None

    def _kind(self, message: can.Message) -> Hashable | None:
        return self.codec.name_of(
            message.arbitration_id, extended=message.is_extended_id, remote=message.is_remote_frame
        )

    def _overhear(self, kind: Hashable, data: bytes) -> None:
        """Take in what the axis says on its own, and the late answers on what changes slowly."""
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

    def _nobody(self) -> str:
        if self._link.error_frames:
            return self._garbled(f"{self._link.error_frames} error frames on the bus")
        return (
            f"no ODrive axis {self._config.id} is heard on {self._link.name} at {self._config.bitrate} bit/s: check "
            "its power, the wiring and its termination, the node id, the bit rate (250000 in a new drive), and that "
            "its heartbeat is switched on"
        )

    def _garbled(self, reason: str) -> str:
        return (
            f"what answers as ODrive axis {self._config.id} cannot be understood ({reason}): two drives with that "
            "node id, or a bit rate that is off; connect one drive alone and give each its own id"
        )


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(str(number) for number in version)
