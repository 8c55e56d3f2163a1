"""Parameters of an ODrive with firmware 0.6, by the vendor's names, written over CAN and read back.

An endpoint's number changes from firmware to firmware, so the numbers come from the flat_endpoints.json that the vendor
publishes with each, and that must be the one of the firmware in the drive. Firmware 0.6.11 and later answers a write;
that answer is a `tx_sdo` too, so a value is always asked for anew.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.odrive.messages import Codec, endpoint_names
from drivers.servo import BadReply, DriverError, NoReply

if TYPE_CHECKING:
    from drivers.canbus.requests import Requests

_READ, _WRITE = 0, 1
_TRIES = 3
_ANSWER_TO_WRITE = 0.003
"""s in which a drive that answers writes has done so."""
_FORMATS = {
    "bool": "<?",
    "uint8": "<B",
    "int8": "<b",
    "uint16": "<H",
    "int16": "<h",
    "uint32": "<I",
    "int32": "<i",
    "float": "<f",
}


class Parameters:
    """The parameters of the axis that `requests` speak to.

    Raises DriverError where the file cannot be read, is for another firmware, or lacks a parameter that is needed.
    """

    def __init__(self, path: str, firmware: str, requests: Requests, codec: Codec) -> None:
        self._requests = requests
        self._codec = codec
        self._found: dict[str, float] = {}
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
            stated, self._endpoints = str(content["fw_version"]), content["endpoints"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DriverError(f"odrive.endpoints: {path} is no flat_endpoints.json of the vendor's ({error})") from None
        if stated.partition("-")[0] != firmware:
            raise DriverError(
                f"odrive.endpoints: {path} is for firmware {stated}, and the drive has {firmware}: "
                "take the file that was published with the drive's firmware"
            )
        missing = [name for name in endpoint_names().values() if name not in self._endpoints]
        if missing:
            raise DriverError(f"odrive.endpoints: {path} lacks {', '.join(missing)}")

    def get(self, name: str) -> float:
        """A value. Raises NoReply, LinkLost, BadReply."""
        number, layout = self._endpoint(name)
        ask = self._codec.put("rx_sdo", _READ, number, 0, bytes(4))
        for attempt in range(_TRIES):
            try:
                data = self._requests.ask([ask], ["tx_sdo"])["tx_sdo"]
                _, answered, _, value = self._codec.decoded("tx_sdo", data.ljust(8, b"\0"))
            except (NoReply, BadReply):
                if attempt == _TRIES - 1:
                    raise
                continue
            if answered == number:
                return float(struct.unpack_from(layout, value)[0])
        raise BadReply(f"{name}: the drive answers for another parameter")

    def require(self, name: str, value: float) -> None:
        """Make a parameter hold `value` as exactly as it can, and read it back; what was found is kept for `restore`.

        Raises DriverError where the drive keeps another value.
        """
        layout = self._endpoint(name)[1]
        wanted: Any = bool(value) if layout == "<?" else value if layout == "<f" else int(value)
        exact = float(struct.unpack(layout, struct.pack(layout, wanted))[0])
        found = self.get(name)
        if found == exact:
            return
        self._found.setdefault(name, found)
        self._put(name, wanted)
        kept = self.get(name)
        if kept != exact:
            raise DriverError(
                f"the drive keeps {kept:g} in {endpoint_names()[name]} where {exact:g} was written: "
                "it is not safe to go on"
            )

    def restore(self) -> None:
        """Put everything back as it was found, as far as the drive lets us."""
        while self._found:
            name, value = self._found.popitem()
            layout = self._endpoint(name)[1]
            try:
                self._put(name, bool(value) if layout == "<?" else value)
            except DriverError:
                continue  # one that cannot be put back must not keep the others from it

    def _put(self, name: str, value: Any) -> None:
        number, layout = self._endpoint(name)
        self._requests.tell([self._codec.put("rx_sdo", _WRITE, number, 0, struct.pack(layout, value).ljust(4, b"\0"))])
        self._requests.await_change(_ANSWER_TO_WRITE, lambda: False)

    def _endpoint(self, name: str) -> tuple[int, str]:
        entry = self._endpoints[endpoint_names()[name]]
        return int(entry["id"]), _FORMATS[entry["type"]]
