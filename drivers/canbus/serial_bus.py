"""A USB-CAN adapter of a motor's maker, at a serial port, as a bus of python-can."""

from __future__ import annotations

import time

import can
import serial

from drivers.canbus.at_frames import AtFrames
from drivers.canbus.damiao import DamiaoFrames
from drivers.uart.port import open_port

BAUDRATE = 921_600
"""bit/s of the serial port; an adapter with a USB controller of its own accepts any."""


class SerialBus(can.BusABC):
    """The bus behind an adapter at the serial port `channel`. frames: the adapter's own bytes.

    serialPortOrig: the open port; python-can's slcan bus uses this name too. Raises DriverError if the port cannot be
    opened or the adapter refuses the bit rate.
    """

    def __init__(self, channel: str, frames: AtFrames | DamiaoFrames) -> None:
        self.serialPortOrig = open_port(channel, BAUDRATE)
        self.frames = frames
        super().__init__(channel)
        try:
            self.serialPortOrig.reset_input_buffer()
            frames.begin(self.serialPortOrig)
        except BaseException:
            self.shutdown()
            raise

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - python-can's signature
        """Send a frame. Raises can.CanError if the port does not take it."""
        try:
            self.serialPortOrig.write(self.frames.encoded(msg))
        except serial.SerialException as error:
            raise can.CanOperationError(f"the adapter takes no frame: {error}") from error

    def shutdown(self) -> None:
        """Close the port."""
        super().shutdown()
        self.serialPortOrig.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.frames.received(self.serialPortOrig, time.monotonic() + (timeout or 0.0)), False
