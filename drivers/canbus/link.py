"""Send and receive frames on a CAN bus with python-can. Every wait has a limit, and every error is a `DriverError`.

This module corrects python-can in six places. python-can's `recv` measures its wait with the wall clock, which may be
set; here a monotonic deadline is used. python-can's slcan interface raises for ever after one byte above 0x7F and
waits 2 s to open. python-can lets two programs command one bus; here a bus has one owner. python-can reads
configuration files; here they are ignored. python-can accepts a frame with fewer bytes than its length code says; here
it is refused. udp_multicast returns the frames that this program sent; `drivers.canbus.multicast` drops them.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import can
import serial

from drivers.canbus.at_frames import AtFrames
from drivers.canbus.damiao import DamiaoFrames
from drivers.canbus.off_path import Encode, datagram, encoded, from_slcan_text, slcan_text, socketcan_bytes
from drivers.canbus.serial_bus import SerialBus
from drivers.clock import no_later
from drivers.off_path import OffPath, OwnBus, descriptor_of
from drivers.owner import Claim
from drivers.servo import BadReply, DriverError, LinkLost, NoReply, link_lost
from drivers.uart.port import GONE, REMEDIES, hasten

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from drivers.clock import Clock

logging.getLogger("can").addHandler(logging.NullHandler())  # its errors are raised; it would also print them

WRITE_TIMEOUT = 0.1
"""s in which the interface must accept a frame; without a limit a stuck adapter would block this program for ever."""
BUDGET = 2048
"""Most frames that are read at once; a bus that has more frames to read counts as one that never falls silent."""
_AT_LEAST = 5e-3  # s of that, though the time for replies is over
_BUS_OFF = 0x040  # class of error frame, include/uapi/linux/can/error.h
_FD_CLOCK = 80_000_000
_SLCAN_SETTLE = 0.05
_PATIENCE = 0.05  # s for a frame that the bus does not accept

_REMEDIES = REMEDIES | {
    errno.EBUSY: "another program has it open: close that first",
    errno.ENODEV: "there is no such interface: check the adapter, and the name with `ip link`",
    errno.ENOENT: "there is no such port: check the adapter and the name",
    errno.ENETDOWN: "the interface is down: bring it up with `ip link set NAME up type can bitrate N`",
    errno.EAFNOSUPPORT: "this system has no SocketCAN: use interface = 'slcan' or the adapter's own",
}
_UNKNOWN = (
    "the bus cannot be opened: install the driver and the library of the adapter's maker, and check interface, channel "
    "and bit rate in the stand file"
)
_SERIAL = frozenset({"slcan", "serial", "robotell", "seeedstudio"})
"""The interfaces of python-can whose channel is a serial port."""
_GONE: tuple[type[Exception], ...] = (can.CanError, *GONE)
_GARBLED: tuple[type[Exception], ...] = (ValueError, IndexError, TypeError, KeyError)
"""The errors that slcan raises, or wraps, for bytes that do not form a frame; UnicodeDecodeError is a ValueError."""


_ADAPTERS: dict[str, type[AtFrames | DamiaoFrames]] = {"damiao": DamiaoFrames, "robstride": AtFrames}
"""Serial adapters with frames of their makers."""


def interfaces() -> list[str]:
    """Return the kinds of bus that a stand file can name."""
    return sorted({*_ADAPTERS, *can.interfaces.VALID_INTERFACES})


@dataclass(frozen=True, slots=True)
class BusConfig:
    """The configuration of a bus. interface, channel: names of python-can. bitrate: bit/s. data_bitrate: bit/s of the
    data of CAN FD; a value above 0 opens CAN FD.
    """

    interface: str
    channel: str
    bitrate: int
    data_bitrate: int = 0

    @classmethod
    def of(cls, table: Any) -> Self:
        """Return the bus that a table of stand.toml names by these keys."""
        return cls(table.interface, table.channel, table.bitrate, getattr(table, "data_bitrate", 0))

    @property
    def name(self) -> str:
        """Interface and channel as one text, for messages."""
        return f"{self.interface} {self.channel}"


def frame(
    ident: int, data: bytes = b"", *, remote: bool = False, extended: bool = False, fd: bool = False
) -> can.Message:
    """Return a frame to send.

    ident: CAN identifier. remote: a remote frame, which requests data. extended: a 29 bit identifier. fd: a CAN FD
    frame with the faster data rate.
    """
    return can.Message(
        arbitration_id=ident,
        data=data,
        is_remote_frame=remote,
        is_extended_id=extended,
        is_fd=fd,
        bitrate_switch=fd,
        check=True,
    )


def _options(config: BusConfig) -> dict[str, Any]:
    """Return the arguments with which python-can opens the interface: each interface has other options for the bit
    rates.
    """
    fd = config.data_bitrate > 0
    if config.interface == "virtual":
        return {}
    if config.interface == "socketcan":
        return {"fd": fd}  # the bit rates are those that `ip link` set
    settle = {"sleep_after_open": _SLCAN_SETTLE} if config.interface == "slcan" else {}
    if not fd:
        return {"bitrate": config.bitrate, **settle}
    timing = can.BitTimingFd.from_sample_point(
        f_clock=_FD_CLOCK,
        nom_bitrate=config.bitrate,
        nom_sample_point=64.0,
        data_bitrate=config.data_bitrate,
        data_sample_point=56.0,
    )
    return {"timing": timing, **settle} if settle else {"timing": timing, "fd": True}


def claimed(config: BusConfig) -> Claim:
    """Return the lock of the bus that `config` names. Raises DriverError, which names the process that uses the bus.

    The lock is taken before the bus is opened, because python-can resets some adapters while it opens them.
    """
    channel = config.channel.strip()
    if config.interface in _SERIAL and "://" not in channel:
        return Claim(config.name, Path(channel.partition("@")[0]))
    where = f"{os.getpid()} " if config.interface == "virtual" else ""  # a bus of this process alone
    with contextlib.suppress(ValueError):
        channel = str(int(channel))
    return Claim(f"{where}{config.interface} {channel.casefold()}")


def open_interface(config: BusConfig) -> can.BusABC:
    """Open and return the python-can bus that `config` names. Raises DriverError with the remedy."""
    try:
        if config.interface == "udp_multicast":
            return _multicast(config.channel)
        if config.interface in _ADAPTERS and not config.data_bitrate:
            return SerialBus(config.channel, _ADAPTERS[config.interface](config.bitrate))
        bus: can.BusABC = can.Bus(
            interface=config.interface, channel=config.channel, ignore_config=True, **_options(config)
        )
    except DriverError:
        raise
    except Exception as error:  # noqa: BLE001 - an interface raises what the library of its adapter's maker raises
        raise DriverError(f"{config.name}: {_remedy(error)} ({type(error).__name__}: {error})") from None
    hasten(getattr(bus, "serialPortOrig", None))
    return bus


def _multicast(channel: str) -> can.BusABC:
    from drivers.canbus.multicast import MulticastBus

    return MulticastBus(channel)


def _errno(error: BaseException | None) -> int:
    """Return the system's errno of `error` or of its cause, 0 without one. (A CanError's `error_code` may be a vendor's
    number.)
    """
    while error is not None:
        if number := getattr(error, "errno", None):
            return int(number)
        error = error.__cause__ or error.__context__
    return 0


def _remedy(error: BaseException) -> str:
    return _REMEDIES.get(_errno(error), _UNKNOWN)


class CanLink:
    """An open CAN bus. error_frames: number of error frames that the CAN controller has reported.

    bus: an open bus, which tests pass; without it the bus of `config` is opened. Raises DriverError with the remedy.
    """

    def __init__(self, config: BusConfig, clock: Clock, bus: can.BusABC | None = None) -> None:
        self.name = config.name
        self._config = config
        self._opened_here = bus is None
        self.error_frames = 0
        self._clock = clock
        self._claim = None if bus else claimed(config)
        try:
            self._bus = bus or open_interface(config)
        except BaseException:
            self._release()
            raise
        self._port = getattr(self._bus, "serialPortOrig", None)
        """The serial port of slcan, None for every other interface."""
        self._closed = False

    def send(self, message: can.Message) -> None:
        """Send a frame. Raises LinkLost, and NoReply where no node on the bus acknowledges."""
        if self._closed:
            raise LinkLost(f"{self.name} is closed")
        now = self._clock.now()
        try:
            self._bus.send(message, timeout=max(_AT_LEAST, no_later(now + WRITE_TIMEOUT) - now))
        except _GONE as error:
            if _is_full(error):
                raise NoReply(
                    f"{self.name} has no room for another frame: no node on the bus acknowledges; check the drive's "
                    "power, the wiring and its termination, and the bit rate"
                ) from None
            raise self._lost(error) from None

    def receive(self, deadline: float) -> can.Message | None:
        """Return the next frame; None if no frame arrived before `deadline`, s on the clock. Reads at least once.

        Raises LinkLost, and BadReply if the received bytes do not form a frame.
        """
        if self._closed:
            raise LinkLost(f"{self.name} is closed")
        deadline = no_later(deadline)
        for _ in range(BUDGET):
            message = self._next(max(0.0, deadline - self._clock.now()))
            if message is not None and message.is_error_frame:
                self._count(message)
            elif message is not None:
                if not message.is_remote_frame and len(message.data) != message.dlc:
                    raise BadReply("a frame arrived cut short: it is dropped")
                return message
            if message is None and self._clock.now() >= deadline and not self._unread():
                return None
        raise BadReply(f"{self.name} carries error frames without a pause: check wiring, bit rate and termination")

    def waiting(self) -> list[can.Message]:
        """Return all frames that have arrived, without waiting; damaged frames are dropped. Raises LinkLost,
        BadReply.
        """
        out: list[can.Message] = []
        for _ in range(BUDGET):
            try:
                message = self.receive(-1.0)
            except BadReply:
                continue
            if message is None:
                return out
            out.append(message)
        raise BadReply(f"{self.name} never falls silent: another program or a broken drive keeps talking on it")

    def off_path(self, off: Iterable[can.Message], restore: Iterable[can.Message] = ()) -> OffPath:
        """Return the data with which another process can send the frames `off`, which switch the torque off, and then
        `restore`, on this bus.
        """
        config, bus = self._config, self._bus
        where: dict[str, Any] = {}
        encode: Encode = slcan_text
        if isinstance(bus, SerialBus):  # no bytes that end its frame are without effect on the motor
            encode, where = bus.frames.encoded, {"descriptor": descriptor_of(self._port)}
        elif self._port is not None:
            where = {"descriptor": descriptor_of(self._port), "resync": b"\r"}
        elif not self._opened_here or config.interface == "virtual":
            pass  # the drive is in this process, and ends with it
        elif config.interface == "socketcan":
            encode, where = socketcan_bytes, {"descriptor": descriptor_of(bus)}
        elif config.interface == "udp_multicast":
            from drivers.canbus.multicast import PORT

            encode, where = datagram, {"descriptor": descriptor_of(bus), "to": (config.channel, PORT)}
        else:
            where = {"bus": OwnBus(config.interface, config.channel, config.bitrate, config.data_bitrate)}
        if self._claim is not None:
            where["lock"] = self._claim.descriptor
        return OffPath(encoded(off, encode), encoded(restore, encode), name=self.name, **where)

    def close(self) -> None:
        """Close the bus. Has no effect if the bus is closed already or the adapter is unplugged."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(*_GONE, *_GARBLED):
            self._bus.shutdown()
        if self._port is not None:  # slcan leaves its port open where the closing command could not be written
            with contextlib.suppress(*_GONE):
                self._port.close()
        self._release()

    def _release(self) -> None:
        if self._claim is not None:
            self._claim.release()

    def _next(self, timeout: float) -> can.Message | None:
        if timeout <= 0.0 and self._port is not None and not self._unread():
            return None  # python-can would wait for a byte, 1 ms long
        try:
            # the interface's own wait: `recv` around it goes by the wall clock
            message, _ = self._bus._recv_internal(timeout)
        except (*_GONE, *_GARBLED) as error:
            if not isinstance(error, _GARBLED) and not isinstance(error.__cause__, _GARBLED):
                raise self._lost(error) from None
            flush = getattr(self._bus, "flush", None)
            if flush is not None:
                with contextlib.suppress(*_GONE):
                    flush()
            raise BadReply("bytes arrived that are no CAN frame: they are dropped") from None
        return message

    def _unread(self) -> bool:
        """Return whether a serial adapter has more bytes to read: the adapter also sends lines that are not frames."""
        if self._port is None:
            return False
        try:
            return bool(self._port.in_waiting)
        except _GONE as error:
            raise self._lost(error) from None

    def _count(self, message: can.Message) -> None:
        self.error_frames += 1
        if message.arbitration_id & _BUS_OFF:
            raise LinkLost(
                f"{self.name} is bus-off: its controller gave up after too many errors, so that torque-off cannot be "
                "sent; cut the drive's power, then check wiring, termination and bit rate, and restart the interface"
            )

    def _lost(self, error: BaseException) -> LinkLost:
        remedy = _remedy(error)
        return link_lost(self.name, error if remedy == _UNKNOWN else f"{error}: {remedy}")


def _is_full(error: Exception) -> bool:
    """Return whether `error` means that the send queue of SocketCAN or of the serial adapter is full."""
    if _errno(error) == errno.ENOBUFS:
        return True
    return "buffer full" in str(error) or isinstance(error.__cause__, serial.SerialTimeoutException)


def sender(config: Mapping[str, Any]) -> Callable[[bytes], None]:
    """Open the bus of `config` and return a function that sends one frame, given as the text of `slcan_text`.

    This call raises OSError if the bus cannot be opened; the returned function raises OSError if the bus refuses the
    frame.
    """
    try:
        bus = open_interface(BusConfig(**config))
    except DriverError as error:
        raise OSError(str(error)) from None

    def send(text: bytes) -> None:
        try:
            bus.send(from_slcan_text(text), timeout=_PATIENCE)
        except can.CanError as error:
            raise OSError(str(error)) from None

    return send
