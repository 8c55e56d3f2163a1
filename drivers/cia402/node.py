"""One CiA 402 drive on the bus: its PDO mapping, limits and changes of state (enable, torque off).

Objects that arming writes are read back, and are restored when the drive is closed. The PDO mapping and the heartbeat
times are in the drive's RAM; a reset of the node's communication restores them.
"""

from __future__ import annotations

import contextlib
import math
import struct
from typing import TYPE_CHECKING

from drivers.canbus.link import frame
from drivers.cia402.nameplate import Nameplate
from drivers.cia402.network import SYNC, LinkedNetwork, Refused
from drivers.cia402.objects import Objects
from drivers.cia402.profiles import HEARTBEAT_LOST, NOT_ENABLED, RESTARTED, ObjectIndex, fault, profile
from drivers.cia402.states import DISABLE_VOLTAGE, FAULT_RESET, NEXT, QUICK_STOP, DriveState, state_of
from drivers.retry import retry
from drivers.servo import DeviceFault, DriverError, NoReply
from drivers.torque_constant import check_current

if TYPE_CHECKING:
    from collections.abc import Callable

    import can

    from drivers.canbus.link import CanLink
    from drivers.cia402.config import Cia402Config
    from drivers.cia402.nameplate import Scale
    from drivers.clock import Clock
    from drivers.retry import retry
from drivers.servo import Limits

CONTROLWORD, STATUSWORD = ObjectIndex(0x6040, 0), ObjectIndex(0x6041, 0)
_MODE, _MODE_DISPLAY = ObjectIndex(0x6060, 0), ObjectIndex(0x6061, 0)
_POSITION, _VELOCITY = ObjectIndex(0x6064, 0), ObjectIndex(0x606C, 0)
_CONSUMER, _PRODUCER = ObjectIndex(0x1016, 1), ObjectIndex(0x1017, 0)
_HEARTBEAT = 100
"""ms between two heartbeats of the drive."""
_OPERATIONAL = 5
START, PRE_OPERATIONAL, RESET_COMMUNICATION = 0x01, 0x80, 0x82
_OFF = 1 << 31
_ASYNCHRONOUS, _EVERY_SYNC = 255, 1
_DISABLE_VOLTAGE_OPTION = 2
_SWITCHING = 0.5
"""s to wait for a change of state: when switched on, a power stage first measures the offsets of its current
sensors.
"""

TPDO1 = struct.Struct("<Hih")
"""Layout of the drive's first PDO: statusword, position, torque."""
TPDO2 = struct.Struct("<i")
"""Layout of the drive's second PDO: velocity."""
RPDO1 = struct.Struct("<Hh")
"""Layout of the PDO sent to the drive: controlword, target."""


class Node:
    """One CiA 402 drive, the one of `config`, on an open bus."""

    def __init__(self, config: Cia402Config, link: CanLink, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self.profile = profile(config.profile)
        self.network = LinkedNetwork(link, clock, config.id, config.reply_timeout)
        self.objects = Objects(self.network)
        self.nameplate = Nameplate(config, self.profile, self.objects, self.network, link)
        self._restarted = self._stopped = False
        self._prepared = False
        self._last_heartbeat = -math.inf
        self.network.node.nmt.add_heartbeat_callback(self._on_heartbeat)

    # -- opening ----------------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Map the PDOs and start them. The torque must be off. Raises DriverError."""
        self._restarted, self._stopped = False, True  # until this is done
        self.network.node.nmt.send_command(PRE_OPERATIONAL)
        ident = self._config.id
        self._map(0x1400, 0x200 + ident, [CONTROLWORD, self.profile.target], [2, 2], _ASYNCHRONOUS)
        self._map(0x1800, 0x180 + ident, [STATUSWORD, _POSITION, self.profile.torque], [2, 4, 2], _EVERY_SYNC)
        self._map(0x1801, 0x280 + ident, [_VELOCITY], [4], _EVERY_SYNC)
        for index in (0x1401, 0x1402, 0x1403, 0x1802, 0x1803):
            with contextlib.suppress(Refused):  # a drive with fewer PDOs
                place = ObjectIndex(index, 1)
                self.objects.put(place, self.objects.get(place) | _OFF, 4)
        self.objects.put(_PRODUCER, _HEARTBEAT, 2)
        self._prepared = True
        self._start()
        self._stopped = False

    def _start(self) -> None:
        """Start the PDOs and check that they arrive: NMT commands have no reply. Raises NoReply."""

        def start() -> None:
            self.network.node.nmt.send_command(START)
            self.network.requests.ask([self.sync()], ["tpdo1", "tpdo2"])

        try:
            retry(start, (NoReply,))
        except NoReply:
            raise NoReply(f"CANopen node {self._config.id} sends no PDO on a SYNC") from None

    def _map(self, index: int, cob: int, objects: list[ObjectIndex], sizes: list[int], kind: int) -> None:
        """Map `objects` to one PDO.

        index: its communication parameter (0x1400, 0x1800 ...). cob: its CAN identifier. sizes: bytes of each object.
        kind: transmission type of CiA 301.
        """
        parameter, mapping = index, index + 0x200
        self.objects.put(ObjectIndex(parameter, 1), cob | _OFF, 4)
        self.objects.put(ObjectIndex(mapping, 0), 0, 1)
        for number, (place, size) in enumerate(zip(objects, sizes, strict=True), 1):
            self.objects.put(ObjectIndex(mapping, number), place.object << 16 | place.sub << 8 | 8 * size, 4)
        self.objects.put(ObjectIndex(mapping, 0), len(objects), 1)
        self.objects.put(ObjectIndex(parameter, 2), kind, 1)
        self.objects.put(ObjectIndex(parameter, 1), cob, 4)
        if self.objects.get(ObjectIndex(parameter, 1)) & (_OFF | 0x7FF) != cob:
            raise DriverError(f"the drive refuses the PDO of object 0x{parameter:04X}: nothing was armed")

    def restore(self) -> None:
        """Restore the changed objects, and the PDO mapping by a reset of the node's communication. Never raises
        DriverError.
        """
        self.objects.restore()
        with contextlib.suppress(DriverError):
            if self._prepared:
                self.network.node.nmt.send_command(RESET_COMMUNICATION)

    # -- arming -----------------------------------------------------------------------------------------------------

    def clear_faults(self) -> None:
        """Clear the fault "heartbeat lost"; with `reset_faults`, clear every fault.

        Raises DeviceFault with the drive's code for a fault that is not cleared.
        """
        if state_of(self.objects.get(STATUSWORD)) is not DriveState.FAULT:
            return
        code = self.error_code()
        if code != HEARTBEAT_LOST and not self._config.reset_faults:
            raise fault(code)
        for word in (0, FAULT_RESET, 0):
            self.objects.put(CONTROLWORD, word, 2)
        if not self._reaches(lambda state: state is not DriveState.FAULT):
            raise fault(self.error_code())
        self.network.node.emcy.reset()  # type: ignore[no-untyped-call]  # canopen is typed in parts

    def limit(self, limits: Limits, scale: Scale) -> None:
        """Write the limits into the drive. A limit of the drive that is lower already stays. scale: SI values of the
        drive's counts. Raises DriverError.
        """
        kind = self.profile
        if kind.torque_limit is not None:
            self._lower(kind.torque_limit, limits.torque / scale.torque, "torque limit")
        if kind.current_limit is not None:
            amperes = limits.torque / scale.torque_constant
            if kind.torque_constant is None:
                own = self.objects.get(kind.current_limit) * kind.current_limit_unit
                place = f"object {kind.current_limit}"
                check_current("cia402.torque_constant", scale.torque_constant, limits.torque, own, place)
            self._lower(kind.current_limit, amperes / kind.current_limit_unit, "current limit")
        self._lower(kind.speed_limit, limits.velocity / (kind.speed_limit_unit or scale.velocity), "speed limit")
        if kind.temperature_limit is not None:
            self._lower(kind.temperature_limit, limits.temperature / kind.temperature_unit, "temperature limit")

    def enable(self) -> None:
        """Set torque mode, zero torque and the watchdog, then enable the drive. Raises DriverError, DeviceFault."""
        self.objects.require(_MODE, self.profile.mode, "mode of operation")
        self.objects.put(self.profile.target, 0, 2)
        self.network.while_waiting = self.send_heartbeat  # once the drive watches it, a lost reply must not stop it
        try:
            self._watch()
            self._switch_on()
        finally:
            self.network.while_waiting = lambda: None  # a drive that is to stop must miss it

    def _watch(self) -> None:
        """Make the drive watch our heartbeat: it disables itself when the heartbeat stops."""
        if self._config.watchdog:
            self._require_abort_option()
            milliseconds = max(1, round(self._config.watchdog * 1e3))
            self.objects.put(_CONSUMER, self._config.own_id << 16 | milliseconds, 4)
            self.send_heartbeat(force=True)

    def _switch_on(self) -> None:
        if not self._reaches(lambda state: state is DriveState.ENABLED, drive=True):
            raise DriverError(
                f"the drive is not enabled (it reports: {state_of(self.objects.get(STATUSWORD)).value}): "
                "check its enable and safe-torque-off inputs and its supply"
            )
        shown = self.objects.get(_MODE_DISPLAY, signed=True)
        if shown != self.profile.mode:
            raise DriverError(
                f"the drive is in mode {shown}, not {self.profile.mode}: no set-point was sent; "
                f"check that the drive supports mode {self.profile.mode}"
            )

    def _require_abort_option(self) -> None:
        try:
            self.objects.require(self.profile.abort_option, _DISABLE_VOLTAGE_OPTION, "abort connection option")
        except Refused as error:
            if not (error.missing and self.profile.abort_option_may_be_missing):
                raise

    def _lower(self, place: ObjectIndex, counts: float, what: str) -> None:
        wanted = math.floor(counts * (1.0 + 1e-9))
        if wanted < 1:
            raise DriverError(f"the {what} is below one count of the drive's (object {place}): raise it in [limits]")
        self.objects.require(place, min(self.objects.get(place), wanted), what)

    def _reaches(self, done: Callable[[DriveState], bool], *, drive: bool = False) -> bool:
        """Wait until `done` is true of the drive's state; return False if `_SWITCHING` passes first.

        drive: whether to send the controlwords that lead to ENABLED; only then a fault raises DeviceFault.
        """
        end = self._clock.now() + _SWITCHING
        while True:
            state = state_of(self.objects.get(STATUSWORD))
            if done(state):
                return True
            if drive and state is DriveState.FAULT:
                raise fault(self.error_code())
            if self._clock.now() >= end:
                return False
            if drive:
                self.send_heartbeat()
            if drive and state in NEXT:
                self.objects.put(CONTROLWORD, NEXT[state], 2)
            elif drive and state is DriveState.QUICK_STOP:
                self.objects.put(CONTROLWORD, DISABLE_VOLTAGE, 2)

    # -- running ----------------------------------------------------------------------------------------------------

    def state(self) -> tuple[int, int, int]:
        """Read position, velocity and torque by SDO, in counts: for a drive whose PDOs are off."""
        position, velocity, torque = (
            self.objects.get(place, signed=True) for place in (_POSITION, _VELOCITY, self.profile.torque)
        )
        return position, velocity, torque

    def send_heartbeat(self, *, force: bool = False) -> None:
        """Send our heartbeat if a quarter of the watchdog's time has passed. force: send it in any case."""
        self.network.requests.send(self.due_heartbeat(force=force))

    def due_heartbeat(self, *, force: bool = False) -> list[can.Message]:
        """Return the frame of our heartbeat if a quarter of the watchdog's time has passed, else no frame. force:
        return it in any case.
        """
        now = self._clock.now()
        if not self._config.watchdog or (now - self._last_heartbeat < 0.25 * self._config.watchdog and not force):
            return []
        self._last_heartbeat = now
        return [frame(0x700 + self._config.own_id, b"\x05")]

    def set_point(self, controlword: int, target: int) -> can.Message:
        """Return the PDO with `controlword` and `target`, counts."""
        return frame(0x200 + self._config.id, RPDO1.pack(controlword, target))

    def sync(self) -> can.Message:
        """Return the SYNC frame, to which the drive replies with its state."""
        return frame(SYNC)

    @property
    def away(self) -> bool:
        """Return whether a heartbeat since `prepare` reported that the node has restarted or is not operational."""
        return self._restarted or self._stopped

    def error_code(self) -> int:
        """Return the code of the latched fault: from the newest EMCY, or by SDO if no EMCY arrived. Raises NoReply,
        LinkLost.
        """
        active = self.network.node.emcy.active
        if active:
            return int(active[-1].code)
        try:
            return self.objects.get(self.profile.error_code) & 0xFFFF
        except Refused:
            return 0x1000

    def fault_in(self, state: DriveState) -> DeviceFault:
        """Return the error to raise for an armed drive whose state is `state`, not ENABLED."""
        if self._restarted:
            return fault(RESTARTED)
        if state not in {DriveState.FAULT, DriveState.REACTING}:
            return fault(NOT_ENABLED)
        try:
            return fault(self.error_code())
        except DriverError:
            return fault(0x1000)

    # -- stopping ---------------------------------------------------------------------------------------------------

    def stop(self, *, wake: bool = False) -> None:
        """Send torque-off by PDO at once, then by SDO, and read the state back. Raises DriverError if the torque is
        still on.

        wake: set the node to pre-operational between PDO and SDO, because a stopped node accepts neither; this turns
        its PDOs off.
        """
        self.network.requests.send_now([self.set_point(DISABLE_VOLTAGE, 0)], [])
        if wake or self._stopped:
            self.network.node.nmt.send_command(PRE_OPERATIONAL)
            self._stopped = True
        try:
            self.objects.put(CONTROLWORD, DISABLE_VOLTAGE, 2)
            state = state_of(self.objects.get(STATUSWORD))
        except Refused as error:
            raise DriverError(str(error)) from None
        if state not in {DriveState.NOT_READY, DriveState.DISABLED, DriveState.READY, DriveState.FAULT}:
            self.objects.put(CONTROLWORD, QUICK_STOP, 2)
            raise DriverError(f"the drive reports: {state.value}")

    def off_frames(self) -> list[can.Message]:
        """Return the frames that switch the torque off (disable voltage), by PDO and by SDO."""
        word = DISABLE_VOLTAGE.to_bytes(2, "little")
        return [self.set_point(DISABLE_VOLTAGE, 0), self.network.write_request(CONTROLWORD, word)]

    def restoring(self) -> list[can.Message]:
        """Return the frames that do what `release` and `restore` do: end the watch on our heartbeat and restore the
        drive's settings.
        """
        out = [self.network.write_request(_CONSUMER, bytes(4))] if self._config.watchdog else []
        out += [self.network.write_request(place, data) for place, data in self.objects.changed()]
        return [*out, frame(0x000, bytes([RESET_COMMUNICATION, self._config.id]))]

    def release(self) -> None:
        """End the drive's watch on our heartbeat. Raises DriverError."""
        if self._config.watchdog:
            self.objects.put(_CONSUMER, 0, 4)

    def _on_heartbeat(self, state: int) -> None:
        if state == 0:
            self.network.node.emcy.reset()  # type: ignore[no-untyped-call]  # canopen is typed in parts
            self._restarted = self._restarted or self._prepared
        self._stopped = self._prepared and state != _OPERATIONAL
