"""The stored result of `hil doctor --commission` for each drive, and the torque limit of a run that follows from it.

A drive that was not tested within 30 days, or was tested with another firmware or watchdog, gets half of its stand's
torque limit. A drive that did not release its torque in the test is refused, unless the stand file accepts such a
drive.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path

from drivers.servo import Quantity, ServoInfo
from hil.acquisition.drive_memory import DriveMemory
from hil.acquisition.excitation import Profile
from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.stand.file import Stand

DAYS = 30.0
"""The number of days for which a commissioning result is valid."""
SHARE = 0.5
"""The fraction of the torque limit that a drive without commissioning may use."""
NOTHING_TURNS = frozenset({"sim", "replay"})
"""Backends without a real motor, which need no commissioning."""
_DAY = 86400.0


@dataclass(frozen=True, slots=True)
class Commissioning:
    """The result of commissioning a drive: what switched its torque off in the test.

    time: of the test, s since 1970. firmware: version of the tested drive. watchdog: time without commands, s, after
    which the tested drive stops. releases: whether the drive switched its torque off by itself when commands stopped.
    guardian, second_signal: whether the guardian, and a second stop signal, switched the torque off; guardian is None
    if the drive has no guardian.
    """

    time: float
    firmware: str
    watchdog: float
    releases: bool
    guardian: bool | None
    second_signal: bool

    @property
    def until(self) -> str:
        """Return the last day on which the result is valid, ISO 8601."""
        return datetime.fromtimestamp(self.time + DAYS * _DAY, UTC).date().isoformat()

    @property
    def stops_ours(self) -> bool:
        """Return whether the guardian (if the drive has one) and a second stop signal switched the torque off."""
        return self.second_signal and self.guardian is not False

    def keep(self, info: ServoInfo, mode: Quantity) -> Path:
        """Store this result for the drive `info` and the command mode `mode`; return the path of the file. Raises
        WrongUse.
        """
        memory = _memory(info, mode)
        memory.keep(asdict(self))
        return memory.path


def _memory(info: ServoInfo, mode: Quantity) -> DriveMemory:
    named = () if info.serial and not info.serial_is_id else (info.firmware,)
    return DriveMemory("commissioning", info, *named, mode)


def identity(info: ServoInfo) -> str:
    """Return the text by which the stored results of the drive `info` are found."""
    if info.serial and not info.serial_is_id:
        return f"{info.backend} {info.model}, serial number {info.serial}"
    words = [f"{info.backend} {info.model}", info.serial, f"firmware {info.firmware}" if info.firmware else ""]
    named = ", ".join(word for word in words if word)
    return f"{named} (it reports no serial number, so another drive with these counts as the same)"


def last_outcome(info: ServoInfo, mode: Quantity) -> Commissioning | None:
    """Return the drive's stored result if it is valid today. Return None if there is no result, or its file is
    unusable.
    """
    with suppress(OSError, ValueError, KeyError, TypeError, WrongUse):
        kept = _memory(info, mode).load() or {}
        found = Commissioning(**{one.name: kept[one.name] for one in fields(Commissioning)})
        age = time.time() - found.time
        same = (found.firmware, found.watchdog) == (info.firmware, info.watchdog)
        truths = isinstance(found.releases, bool) and isinstance(found.second_signal, bool)
        if same and truths and -_DAY < age < DAYS * _DAY:
            return found
    return None


def permitted(stand: Stand, info: ServoInfo, profile: Profile) -> tuple[Stand, list[Diagnostic]]:
    """Return the stand with the torque limit that a run of `profile` may use, and a warning if this limit is halved.

    Raises WrongUse if the drive did not release its torque in the test and the stand file does not accept that, or if
    `profile` exceeds the limit.
    """
    if info.backend in NOTHING_TURNS or stand.stand.backend in NOTHING_TURNS:
        return stand, []
    found = last_outcome(info, profile.mode)
    accepted = stand.stand.torque_stays_on_if_host_dies
    if found is not None and not (found.releases or accepted):
        raise WrongUse(
            "this drive kept its torque when no command arrived (hil doctor --commission, valid until "
            f"{found.until}). If this computer stops, the motor pulls until its power is cut. Nothing was driven: "
            "correct its watchdog and commission it again, or accept this with torque_stays_on_if_host_dies = true in "
            "[stand], and keep a switch for its power at hand"
        )
    if found is not None and found.stops_ours:
        return stand, []
    half = SHARE * stand.checked_limits().torque
    remedy = "run hil doctor on the stand file with --commission, which tries whether the drive stops"
    if profile.mode is Quantity.TORQUE and profile.amplitude > half:
        raise WrongUse(
            f"--amplitude {profile.amplitude:g} N m is beyond {half:g} N m, half of the stand's torque limit, and no "
            f"more is driven before the drive is commissioned: {remedy}, or use --amplitude {half:g}"
        )
    halved = Diagnostic(
        "not-commissioned",
        f"it was not tested within {DAYS:.0f} days whether this drive stops when hil stops: the torque limit is "
        f"{half:g} N m now, half of the stand's; {remedy}",
    )
    return with_torque_limit(stand, half), [halved]


def with_torque_limit(stand: Stand, torque: float) -> Stand:
    """Return the stand with the torque limit `torque`, N m at the joint. Raises WrongUse if the stand sets no
    limits.
    """
    return replace(stand, limits=stand.checked_limits().model_copy(update={"torque": torque}))
