"""One CiA 402 drive on the bus: what is written into it, and how it is switched on and off.

What arming writes outside of the communication objects is read back, and put back on closing. PDO mapping and heartbeat
times live in RAM; a reset of the node's communication brings back what is stored.
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
from drivers.cia402.profiles import HEARTBEAT_LOST, NOT_ENABLED, RESTARTED, Place, fault, profile
from drivers.cia402.states import DISABLE_VOLTAGE, FAULT_RESET, NEXT, QUICK_STOP, State, state_of
from drivers.servo import DeviceFault, DriverError, NoReply

if TYPE_CHECKING:
    from collections.abc import Callable

    import can

    from drivers.canbus.link import CanLink
    from drivers.cia402.config import Cia402Config
    from drivers.cia402.nameplate import Scale
    from drivers.clock import Clock
    from drivers.servo import Limits

CONTROLWORD, STATUSWORD = Place(0x6040, 0), Place(0x6041, 0)
_MODE, _MODE_DISPLAY = Place(0x6060, 0), Place(0x6061, 0)
_POSITION, _VELOCITY = Place(0x6064, 0), Place(0x606C, 0)
_CONSUMER, _PRODUCER = Place(0x1016, 1), Place(0x1017, 0)
_HEARTBEAT = 100
"""ms between two heartbeats of the drive."""
_OPERATIONAL = 5
START, PRE_OPERATIONAL, RESET_COMMUNICATION = 0x01, 0x80, 0x82
_OFF = 1 << 31
_ASYNCHRONOUS, _EVERY_SYNC = 255, 1
_DISABLE_VOLTAGE_OPTION = 2
_TRIES = 3
_SWITCHING = 0.5
"""s that a drive may take from state to state: a power stage measures its offsets first."""

TPDO1 = struct.Struct("<Hih")
"""statusword, position, torque."""
TPDO2 = struct.Struct("<i")
"""velocity."""
RPDO1 = struct.Struct("<Hh")
"""controlword, target."""


class Node:
    """The drive of `config` on an open link."""

    def __init__(self, config: Cia402Config, link: CanLink, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self.profile = profile(config.profile)
        self.network = LinkedNetwork(link, clock, config.id, config.reply_timeout)
        self.objects = Objects(self.network)
        self.nameplate = Nameplate(config, self.profile, self.objects, self.network, link)
        self._restarted = self._stopped = False
        self._prepared = False
        self._beaten = -math.inf
        self.network.node.nmt.add_heartbeat_callback(self._heard_state)

    # -- opening ----------------------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Map the PDOs and let them flow; the drive must be without torque. Raises DriverError."""
        self._restarted, self._stopped = False, True  # until it is done
        self.network.node.nmt.send_command(PRE_OPERATIONAL)
        ident = self._config.id
        self._map(0x1400, 0x200 + ident, [CONTROLWORD, self.profile.target], [2, 2], _ASYNCHRONOUS)
        self._map(0x1800, 0x180 + ident, [STATUSWORD, _POSITION, self.profile.torque], [2, 4, 2], _EVERY_SYNC)
        self._map(0x1801, 0x280 + ident, [_VELOCITY], [4], _EVERY_SYNC)
        for index in (0x1401, 0x1402, 0x1403, 0x1802, 0x1803):
            with contextlib.suppress(Refused):  # a drive with fewer PDOs
                place = Place(index, 1)
                self.objects.put(place, self.objects.get(place) | _OFF, 4)
        self.objects.put(_PRODUCER, _HEARTBEAT, 2)
        self._prepared = True
        self._start()
        self._stopped = False

    def _start(self) -> None:
        """Let the PDOs flow, and see that they do: NMT commands are not answered. Raises NoReply."""
        for attempt in range(_TRIES):
            self.network.node.nmt.send_command(START)
            try:
                self.network.requests.ask([self.sync()], ["tpdo1", "tpdo2"])
            except NoReply:
                if attempt == _TRIES - 1:
                    raise NoReply(f"CANopen node {self._config.id} sends no PDO on a SYNC") from None
            else:
                return

    def _map(self, index: int, cob: int, objects: list[Place], sizes: list[int], kind: int) -> None:
        """Let a PDO carry `objects`."""
        parameter, mapping = index, index + 0x200
        self.objects.put(Place(parameter, 1), cob | _OFF, 4)
        self.objects.put(Place(mapping, 0), 0, 1)
        for number, (place, size) in enumerate(zip(objects, sizes, strict=True), 1):
            self.objects.put(Place(mapping, number), place.object << 16 | place.sub << 8 | 8 * size, 4)
        self.objects.put(Place(mapping, 0), len(objects), 1)
        self.objects.put(Place(parameter, 2), kind, 1)
        self.objects.put(Place(parameter, 1), cob, 4)
        if self.objects.get(Place(parameter, 1)) & (_OFF | 0x7FF) != cob:
            raise DriverError(f"the drive does not take the PDO of object 0x{parameter:04X}: nothing was armed")

    def forget(self) -> None:
        """Put the objects back and let the drive forget our PDOs. Never raises."""
        self.objects.restore()
        with contextlib.suppress(DriverError):
            if self._prepared:
                self.network.node.nmt.send_command(RESET_COMMUNICATION)

    # -- arming -----------------------------------------------------------------------------------------------------

    def clear_faults(self) -> None:
        """Clear what only says that nobody spoke to it, or anything where the stand file allows.

        Raises DeviceFault with the drive's code for any other fault.
        """
        if state_of(self.objects.get(STATUSWORD)) is not State.FAULT:
            return
        code = self.error_code()
        if code != HEARTBEAT_LOST and not self._config.reset_faults:
            raise fault(code)
        for word in (0, FAULT_RESET, 0):
            self.objects.put(CONTROLWORD, word, 2)
        if not self._reaches(lambda state: state is not State.FAULT):
            raise fault(self.error_code())
        self.network.node.emcy.reset()  # type: ignore[no-untyped-call]  # canopen is typed in parts

    def limit(self, limits: Limits, scale: Scale) -> None:
        """Write the limits; none is ever raised above what the drive has. Raises DriverError."""
        kind = self.profile
        if kind.torque_limit is not None:
            self._lower(kind.torque_limit, limits.torque / scale.torque, "torque limit")
        if kind.current_limit is not None:
            amperes = limits.torque / scale.torque_constant
            self._lower(kind.current_limit, amperes / kind.current_limit_unit, "current limit")
        self._lower(kind.speed_limit, limits.velocity / (kind.speed_limit_unit or scale.velocity), "speed limit")
        if kind.temperature_limit is not None:
            self._lower(kind.temperature_limit, limits.temperature / kind.temperature_unit, "temperature limit")

    def enable(self) -> None:
        """Torque mode, zero torque, watched by the drive; then through the states. Raises DriverError, DeviceFault."""
        self.objects.require(_MODE, self.profile.mode, "mode of operation")
        self.objects.put(self.profile.target, 0, 2)
        if self._config.watchdog:
            self._require_abort_option()
            milliseconds = max(1, round(self._config.watchdog * 1e3))
            self.objects.put(_CONSUMER, self._config.own_id << 16 | milliseconds, 4)
            self.beat(force=True)
        if not self._reaches(lambda state: state is State.ENABLED, drive=True):
            raise DriverError(
                f"the drive is not enabled (it says: {state_of(self.objects.get(STATUSWORD)).value}): "
                "check its enable and safe-torque-off inputs and its supply"
            )
        shown = self.objects.get(_MODE_DISPLAY, signed=True)
        if shown != self.profile.mode:
            raise DriverError(f"the drive is in mode {shown}, not {self.profile.mode}: nothing was driven")

    def _require_abort_option(self) -> None:
        try:
            self.objects.require(self.profile.abort_option, _DISABLE_VOLTAGE_OPTION, "abort connection option")
        except Refused as error:
            if not (error.missing and self.profile.abort_option_may_be_missing):
                raise

    def _lower(self, place: Place, counts: float, what: str) -> None:
        wanted = math.floor(counts * (1.0 + 1e-9))
        if wanted < 1:
            raise DriverError(f"the {what} is below one count of the drive's (object {place}): raise it in [limits]")
        found = self.objects.get(place)
        self.objects.require(place, min(found, wanted), what)

    def _reaches(self, done: Callable[[State], bool], *, drive: bool = False) -> bool:
        """Whether a state that is `done` comes; where `drive`, by the controlwords that lead on. Raises DeviceFault."""
        end = self._clock.now() + _SWITCHING
        while True:
            state = state_of(self.objects.get(STATUSWORD))
            if done(state):
                return True
            if drive and state is State.FAULT:
                raise fault(self.error_code())
            if self._clock.now() >= end:
                return False
            if drive:
                self.beat()
            if drive and state in NEXT:
                self.objects.put(CONTROLWORD, NEXT[state], 2)
            elif drive and state is State.QUICK_STOP:
                self.objects.put(CONTROLWORD, DISABLE_VOLTAGE, 2)

    # -- running ----------------------------------------------------------------------------------------------------

    def beat(self, *, force: bool = False) -> None:
        """Send our heartbeat where it is due."""
        self.network.requests.tell(self.due_beat(force=force))

    def due_beat(self, *, force: bool = False) -> list[can.Message]:
        """Our heartbeat where a quarter of the watchdog's time has gone by, else nothing."""
        now = self._clock.now()
        if not self._config.watchdog or (now - self._beaten < 0.25 * self._config.watchdog and not force):
            return []
        self._beaten = now
        return [frame(0x700 + self._config.own_id, b"\x05")]

    def set_point(self, controlword: int, target: int) -> can.Message:
        """The frame of a set-point."""
        return frame(0x200 + self._config.id, RPDO1.pack(controlword, target))

    def sync(self) -> can.Message:
        """The frame on which the drive says its state."""
        return frame(SYNC)

    @property
    def away(self) -> bool:
        """Whether it has said in a heartbeat since `prepare` that it was restarted, or is not operational any more."""
        return self._restarted or self._stopped

    def error_code(self) -> int:
        """The code of the fault that is latched: of its newest EMCY, else of its objects. Raises NoReply, LinkLost."""
        active = self.network.node.emcy.active
        if active:
            return int(active[-1].code)
        try:
            return self.objects.get(self.profile.error_code) & 0xFFFF
        except Refused:
            return 0x1000

    def trouble(self, state: State) -> DeviceFault:
        """The fault for an armed drive found in `state`."""
        if self._restarted:
            return fault(RESTARTED)
        if state not in {State.FAULT, State.REACTING}:
            return fault(NOT_ENABLED)
        try:
            return fault(self.error_code())
        except DriverError:
            return fault(0x1000)

    # -- stopping ---------------------------------------------------------------------------------------------------

    def stop(self, *, wake: bool = False) -> None:
        """Torque off: sent at once by PDO and again by SDO, then read back. Raises DriverError where it is not so.

        wake: make the node pre-operational in between, since a stopped one takes neither; its PDOs are off then.
        """
        self.network.requests.fire([self.set_point(DISABLE_VOLTAGE, 0)], [])
        if wake or self._stopped:
            self.network.node.nmt.send_command(PRE_OPERATIONAL)
            self._stopped = True
        try:
            self.objects.put(CONTROLWORD, DISABLE_VOLTAGE, 2)
            state = state_of(self.objects.get(STATUSWORD))
        except Refused as error:
            raise DriverError(str(error)) from None
        if state not in {State.NOT_READY, State.DISABLED, State.READY, State.FAULT}:
            self.objects.put(CONTROLWORD, QUICK_STOP, 2)
            raise DriverError(f"it says: {state.value}")

    def release(self) -> None:
        """Let it no longer watch our heartbeat. Raises DriverError."""
        if self._config.watchdog:
            self.objects.put(_CONSUMER, 0, 4)

    def _heard_state(self, state: int) -> None:
        if state == 0:
            self.network.node.emcy.reset()  # type: ignore[no-untyped-call]  # canopen is typed in parts
            self._restarted = self._restarted or self._prepared
        self._stopped = self._prepared and state != _OPERATIONAL
