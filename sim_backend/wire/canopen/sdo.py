"""The SDO server of an emulated CANopen device: it answers requests of 8 bytes with replies of 8 bytes.

Source: CiA 301, 7.2.4. Expedited and segmented transfers are supported. Block transfers are refused, like any unknown
command.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from sim_backend.wire.canopen.dictionary import COMMAND, TOGGLE, Abort

if TYPE_CHECKING:
    from sim_backend.wire.canopen.dictionary import Dictionary

_HEAD = struct.Struct("<BHB")


class SdoServer:
    """The SDO server of one device, with at most one transfer in progress."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._dictionary = dictionary
        self._index = self._sub = 0
        self._sending: bytes | None = None
        self._taking: bytearray | None = None
        self._toggle = 0
        self._commands = {
            0: self._download,
            1: self._begin_download,
            2: self._begin_upload,
            3: self._upload,
        }

    def answer(self, request: bytes) -> bytes | None:
        """Return the reply to a request; None if there is no reply."""
        if len(request) != 8:
            return None
        command = request[0] >> 5
        if command == 4:  # the client gives up
            self._sending = self._taking = None
            return None
        if command in {1, 2}:
            _, self._index, self._sub = _HEAD.unpack_from(request)
        try:
            if command not in self._commands:
                raise Abort(COMMAND)
            return self._commands[command](request)
        except Abort as abort:
            self._sending = self._taking = None
            return _HEAD.pack(0x80, self._index, self._sub) + abort.code.to_bytes(4, "little")

    def _done(self) -> bytes:
        return _HEAD.pack(0x60, self._index, self._sub) + bytes(4)

    def _begin_download(self, request: bytes) -> bytes:
        self._dictionary.entry(self._index, self._sub)
        if request[0] & 0x02:
            size = 4 - (request[0] >> 2 & 3) if request[0] & 0x01 else 4
            self._dictionary.write(self._index, self._sub, request[4 : 4 + size])
            return self._done()
        self._taking = bytearray()
        self._toggle = 0
        return self._done()

    def _download(self, request: bytes) -> bytes:
        if self._taking is None:
            raise Abort(COMMAND)
        toggle = request[0] >> 4 & 1
        if toggle != self._toggle:
            raise Abort(TOGGLE)
        self._taking += request[1 : 8 - (request[0] >> 1 & 7)]
        self._toggle ^= 1
        if request[0] & 1:
            data, self._taking = bytes(self._taking), None
            self._dictionary.write(self._index, self._sub, data)
        return bytes([0x20 | toggle << 4]) + bytes(7)

    def _begin_upload(self, _request: bytes) -> bytes:
        data = self._dictionary.encoded(self._index, self._sub)
        if 0 < len(data) <= 4:
            return _HEAD.pack(0x43 | (4 - len(data)) << 2, self._index, self._sub) + data.ljust(4, b"\0")
        self._sending = data
        self._toggle = 0
        return _HEAD.pack(0x41, self._index, self._sub) + len(data).to_bytes(4, "little")

    def _upload(self, request: bytes) -> bytes:
        if self._sending is None:
            raise Abort(COMMAND)
        toggle = request[0] >> 4 & 1
        if toggle != self._toggle:
            raise Abort(TOGGLE)
        part, rest = self._sending[:7], self._sending[7:]
        self._toggle ^= 1
        self._sending = rest or None
        return bytes([toggle << 4 | (7 - len(part)) << 1 | (not rest)]) + part.ljust(7, b"\0")
