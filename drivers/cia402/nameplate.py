"""Identify a CiA 402 drive, and find the SI value of one count of its position, velocity and torque."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.canbus.requests import SECOND_REPLY
from drivers.cia402.network import Refused
from drivers.cia402.profiles import ObjectIndex
from drivers.servo import BadReply, DriverError, NoReply
from drivers.torque_constant import contradiction

if TYPE_CHECKING:
    from drivers.canbus.link import CanLink
    from drivers.cia402.config import Cia402Config
    from drivers.cia402.network import LinkedNetwork
    from drivers.cia402.objects import Objects
    from drivers.cia402.profiles import Profile

_DEVICE_TYPE, _NAME = ObjectIndex(0x1000, 0), ObjectIndex(0x1008, 0)
_IDENTITY = [ObjectIndex(0x1018, sub) for sub in (1, 2, 3, 4)]
_REVOLUTIONS_PER_MINUTE = 0xB447
"""The code of the unit rev/min in CiA 303-2. In object 0x60A9 it stands between a power of ten and a zero byte."""


@dataclass(frozen=True, slots=True)
class Scale:
    """The SI value of one count: position rad, velocity rad/s, torque N m. torque_constant: N m/A, NaN if not known."""

    position: float
    velocity: float
    torque: float
    torque_constant: float


@dataclass(frozen=True, slots=True)
class Identity:
    """Model, serial number and firmware of a drive."""

    model: str
    serial: str
    firmware: str


class Nameplate:
    """Reads identity and units of the drive of `config`. `profile` names the objects that the drive should have."""

    def __init__(
        self, config: Cia402Config, profile: Profile, objects: Objects, network: LinkedNetwork, link: CanLink
    ) -> None:
        self._config = config
        self._profile = profile
        self._objects = objects
        self._network = network
        self._link = link

    def identify(self) -> Identity:
        """Return model, serial number and firmware of the drive. Raises NoReply, BadReply if several drives reply,
        DriverError for another kind of drive.
        """
        try:
            kind = self._objects.get(_DEVICE_TYPE) & 0xFFFF
            self._check_alone()
            vendor, product, revision, serial = (self._identity(place) for place in _IDENTITY)
            self._check_alone()
        except NoReply:
            raise NoReply(self._no_reply()) from None
        if kind != 402:
            raise DriverError(f"node {self._config.id} has device profile {kind}, not CiA 402: correct cia402.id")
        if self._profile.vendor is not None and vendor != self._profile.vendor:
            raise DriverError(
                f"node {self._config.id} has vendor id 0x{vendor:X}, not maxon's: correct cia402.profile or cia402.id"
            )
        self._check_kind()
        return Identity(self._name(), f"{serial:08x}", f"{revision >> 16:04x} (product 0x{product:08x})")

    def scale(self) -> Scale:
        """Return the SI value of one count. Raises DriverError if the drive contradicts the stand file, or if neither
        states a value.
        """
        reported = self._objects.get(self._profile.resolution) * self._profile.resolution_factor
        counts = self._agreed("resolution", self._config.resolution, reported, "counts a turn")
        constant = self._torque_constant()
        torque = 1e-3 * (self._rated_torque() if self._profile.per_mille else constant)
        return Scale(math.tau / counts, self._velocity_unit(), torque, constant)

    def _check_alone(self) -> None:
        """Raise BadReply if a second drive replies to the last request."""
        answers = self._network.node.sdo.responses
        if self._network.requests.wait_until(SECOND_REPLY, lambda: not answers.empty()) or self._link.error_frames:
            raise BadReply(
                f"node {self._config.id} on {self._link.name} answers twice, or garbled: two drives with that id, "
                "or a bad cable; connect one alone"
            )

    def _check_kind(self) -> None:
        """Raise DriverError if the drive lacks an object that its profile needs."""
        for place in (self._profile.target, self._profile.torque, self._profile.resolution, self._profile.speed_limit):
            try:
                self._objects.get(place)
            except Refused as error:
                if error.missing:
                    raise DriverError(
                        f"node {self._config.id} ({self._name()}) has no object {place}, which the "
                        f"{self._config.profile} has: correct cia402.profile"
                    ) from None
                raise

    def _name(self) -> str:
        try:
            return self._objects.text(_NAME)
        except Refused:
            return "CiA 402 drive"

    def _identity(self, place: ObjectIndex) -> int:
        try:
            return self._objects.get(place)
        except Refused:
            return 0

    def _torque_constant(self) -> float:
        given, place = self._config.torque_constant, self._profile.torque_constant
        if place is None:
            return given if given is not None else math.nan
        return self._agreed(
            "torque_constant", given, self._objects.get(place) * self._profile.torque_constant_unit, "N m/A"
        )

    def _rated_torque(self) -> float:
        given = self._config.rated_torque
        if given is not None and self._profile.torque_constant is not None and self._profile.rated_torque is not None:
            place = self._profile.rated_torque
            reported = self._objects.get(place) * self._profile.rated_torque_unit
            if problem := contradiction("cia402.rated_torque", given, reported, f"the drive (object {place})", "N m"):
                raise DriverError(problem)
        if given is not None or self._profile.rated_torque is None:
            return given or math.nan
        unit = self._config.rated_torque_unit or self._profile.rated_torque_unit
        return self._agreed("rated_torque", None, self._objects.get(self._profile.rated_torque) * unit, "N m")

    def _agreed(self, key: str, given: float | None, reported: float, unit: str) -> float:
        if reported <= 0.0:
            if given is not None:
                return given
            raise DriverError(f"the drive has no {key} (it reports 0): set up motor and sensor with the vendor's tool")
        if given is not None and abs(reported - given) > 0.01 * given:
            raise DriverError(
                f"cia402.{key} is {given:g} {unit} in the stand file and {reported:g} in the drive: "
                "correct the wrong one"
            )
        return reported

    def _velocity_unit(self) -> float:
        if self._profile.velocity_unit is None:
            return math.tau / 60.0
        unit = self._objects.get(self._profile.velocity_unit)
        if unit >> 8 & 0xFFFF != _REVOLUTIONS_PER_MINUTE:
            raise DriverError(
                f"the drive's unit of velocity is not known here (0x60A9 is 0x{unit:08X}): set rev/min, "
                "0x00B44700, or a thousandth of it, 0xFDB44700"
            )
        power = (unit >> 24) - (256 if unit >> 31 else 0)
        return math.tau / 60.0 * float(10.0**power)

    def _no_reply(self) -> str:
        if self._link.error_frames:
            return (
                f"{self._link.error_frames} error frames on {self._link.name} and no CANopen node {self._config.id}: "
                "two drives with that id, a wrong bit rate, or a bad cable"
            )
        return (
            f"no CANopen node {self._config.id} answers on {self._link.name} at {self._config.bitrate} bit/s: check "
            "its power, the wiring and its termination, node id and bit rate (its switches, or the vendor's tool)"
        )
