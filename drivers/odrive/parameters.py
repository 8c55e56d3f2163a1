"""Write parameters of an ODrive with firmware 0.6 over CAN, by the vendor's names, and read them back.

The number of a parameter (endpoint) changes with the firmware. The numbers come from the flat_endpoints.json that the
vendor publishes with each firmware; it must belong to the drive's firmware. Firmware 0.6.11 and later also replies to a
write with `tx_sdo`, so a value is always requested again to read it back.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.odrive.messages import Codec, endpoint_names
from drivers.retry import retry
from drivers.servo import BadReply, DriverError
from drivers.settings import Settings

if TYPE_CHECKING:
    import can

    from drivers.canbus.requests import Requests

_READ, _WRITE = 0, 1
_ANSWER_TO_WRITE = 0.003
"""s to wait after a write, in which a drive that replies to writes has sent its reply."""
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
    """The parameters of one axis.

    path: the vendor's flat_endpoints.json. Raises DriverError if the file cannot be read, belongs to another firmware,
    or lacks a needed parameter.
    """

    def __init__(self, path: str, firmware: str, requests: Requests, codec: Codec) -> None:
        self._requests = requests
        self._codec = codec
        self.settings: Settings[str, float] = Settings(self.get, self._put)
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
            stated, self._endpoints = str(content["fw_version"]), content["endpoints"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DriverError(f"odrive.endpoints: {path} is not the vendor's flat_endpoints.json ({error})") from None
        if stated.partition("-")[0] != firmware:
            raise DriverError(
                f"odrive.endpoints: {path} is for firmware {stated}, and the drive has {firmware}: "
                "use the file published with the drive's firmware"
            )
        missing = [name for name in endpoint_names().values() if name not in self._endpoints]
        if missing:
            raise DriverError(f"odrive.endpoints: {path} lacks {', '.join(missing)}")

    def get(self, name: str) -> float:
        """Return the value of the parameter `name`. Raises NoReply, LinkLost, BadReply."""
        number, layout = self._endpoint(name)
        read = self._codec.put("rx_sdo", _READ, number, 0, bytes(4))

        def request() -> float:
            data = self._requests.ask([read], ["tx_sdo"])["tx_sdo"]
            _, replied, _, value = self._codec.decoded("tx_sdo", data.ljust(8, b"\0"))
            if replied != number:
                raise BadReply(f"{name}: the drive replies for another parameter")
            return float(struct.unpack_from(layout, value)[0])

        return retry(request)

    def require(self, name: str, value: float) -> None:
        """Write `value` to the parameter `name` and read it back; a float may be rounded to 32 bits. Raises DriverError
        if the drive then holds another value.
        """
        layout = self._endpoint(name)[1]
        exact = float(struct.unpack(layout, _packed(layout, value))[0])
        self.settings.require(name, exact, endpoint_names()[name])

    def restoring(self) -> list[can.Message]:
        """Return the frames that restore the parameters that `require` changed."""
        return [self._write(name, value) for name, value in self.settings.changed()]

    def _write(self, name: str, value: float) -> can.Message:
        number, layout = self._endpoint(name)
        message: can.Message = self._codec.put("rx_sdo", _WRITE, number, 0, _packed(layout, value).ljust(4, b"\0"))
        return message

    def _put(self, name: str, value: float) -> None:
        self._requests.send([self._write(name, value)])
        self._requests.wait_until(_ANSWER_TO_WRITE, lambda: False)

    def _endpoint(self, name: str) -> tuple[int, str]:
        entry = self._endpoints[endpoint_names()[name]]
        return int(entry["id"]), _FORMATS[entry["type"]]


def _packed(layout: str, value: float) -> bytes:
    typed: float = bool(value) if layout == "<?" else value if layout == "<f" else int(value)
    return struct.pack(layout, typed)
