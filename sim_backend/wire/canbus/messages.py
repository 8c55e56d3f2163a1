"""Convert frames of the emulated bus to messages of python-can and back."""

from __future__ import annotations

import can

from sim_backend.wire.canbus.frames import CanFrame


def from_message(message: can.Message) -> CanFrame:
    """Convert a message that a client sent to a frame."""
    return CanFrame(
        message.arbitration_id,
        bytes(message.data),
        extended=message.is_extended_id,
        remote=message.is_remote_frame,
        fd=message.is_fd,
        fast=message.bitrate_switch,
    )


def to_message(frame: CanFrame) -> can.Message:
    """Convert `frame` to the message that a client receives."""
    return can.Message(
        arbitration_id=frame.ident,
        data=frame.data,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        is_error_frame=frame.error,
        is_fd=frame.fd,
        bitrate_switch=frame.fast,
    )
