"""The stored result of `hil doctor --commission` for each drive, and the torque limit of a run that follows from it.

A drive that was not tested within 30 days, or was tested with another firmware or watchdog, gets half of its stand's
torque limit. A drive that did not release its torque in a test is refused until it passes a later test, unless the
stand file accepts such a drive. A test of an emulator, on a pty or a virtual bus, counts there only. This is kept in
two places, each of which refuses the drive: the user's state folder and the stand file, which other users and computers
read too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

from drivers.servo import Quantity, ServoInfo
from hil.acquisition.drive_memory import StoredFacts, emulation_of, file_name
from hil.acquisition.excitation import Profile
from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.hand.edit import update
from hil.stand.file import Stand

DAYS = 30.0
"""The number of days for which a commissioning result is valid."""
SHARE = 0.5
"""The fraction of the torque limit that a drive without commissioning may use."""
NOTHING_TURNS = frozenset({"sim", "replay"})
"""Backends without a real motor, which need no commissioning."""
_PLACE = ("model", "port", "interface", "channel", "id")
"""The keys of a drive's table that tell a person which motor it is."""
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

    def keep(self, stand: Stand, info: ServoInfo, mode: Quantity) -> Path:
        """Store this result for the drive `info` of `stand` and the command mode `mode`; return the path of the file.

        The stand file, too, stores whether the drive keeps its torque. Raises WrongUse.
        """
        passed = self.releases and self.stops_ours
        keeps = not self.releases or (not passed and _kept_torque(stand, info, mode))
        name = _name_in_stand(stand, info, mode)
        memory = StoredFacts.of_drive("commissioning", stand, info, mode)
        try:
            if stand.path is not None and keeps != stand.keeps_torque.get(name, False):
                update(stand.path, {"keeps_torque": {name: keeps}}, stand.joint)
        except (OSError, WrongUse) as error:
            raise WrongUse(
                f"{stand.path} cannot note under [keeps_torque] whether its drive keeps its torque ({error}), so that "
                "another user would not know it: make the file writable and commission the drive again"
            ) from None
        finally:
            memory.keep(asdict(self) | {"keeps_torque": keeps, "stand": _drive_of(stand, mode)})
        return memory.path


def _name_in_stand(stand: Stand, info: ServoInfo, mode: Quantity) -> str:
    """Return the drive's key in [keeps_torque]. A drive without a serial number counts as the only one of the stand."""
    return file_name(info.backend, "" if info.serial_is_id else info.serial, mode, *emulation_of(stand))


def _kept_torque(stand: Stand, info: ServoInfo, mode: Quantity) -> bool:
    """Return whether the drive did not release its torque in a test and has not passed a test since.

    A failed test counts however old it is, and after any change of the drive's settings. A file that cannot be read
    counts as a failed test.
    """
    if stand.keeps_torque.get(_name_in_stand(stand, info, mode), False):
        return True
    try:
        memory = StoredFacts.of_drive("commissioning", stand, info, mode)
    except WrongUse:  # a user without a home has never stored a test
        return False
    try:
        kept = memory.load()
        return kept is not None and kept.get("keeps_torque", kept["releases"] is not True) is not False
    except (OSError, ValueError, KeyError, RecursionError, WrongUse):
        return True


def identity(info: ServoInfo) -> str:
    """Return the text by which the stored results of the drive `info` are found."""
    if info.serial and not info.serial_is_id:
        return f"{info.backend} {info.model}, serial number {info.serial}"
    words = [f"{info.backend} {info.model}", info.serial, f"firmware {info.firmware}" if info.firmware else ""]
    named = ", ".join(word for word in words if word)
    return f"{named} (it reports no serial number, so another drive with these counts as the same)"


def last_outcome(stand: Stand, info: ServoInfo, mode: Quantity) -> Commissioning | None:
    """Return the drive's stored result if it is valid today. Return None if there is no result, or its file is
    unusable.
    """
    with suppress(OSError, ValueError, WrongUse):
        found = _valid_today(StoredFacts.of_drive("commissioning", stand, info, mode).load() or {})
        if found is not None and (found.firmware, found.watchdog) == (info.firmware, info.watchdog):
            return found
    return None


def _valid_today(kept: Mapping[str, Any]) -> Commissioning | None:
    """Return the result in the fields of a file; None if the fields are damaged or older than 30 days."""
    with suppress(KeyError, TypeError):
        found = Commissioning(**{one.name: kept[one.name] for one in fields(Commissioning)})
        age = time.time() - found.time
        truths = isinstance(found.releases, bool) and isinstance(found.second_signal, bool)
        if truths and -_DAY < age < DAYS * _DAY:
            return found
    return None


Agree = Callable[[str], object]
"""Gets the announcement of a motion, and returns if a person agrees to it; it raises WrongUse otherwise."""


def require_agreement(stand: Stand, mode: Quantity, motion: str, agree: Agree | None) -> None:
    """Call `agree` before a real motor moves for the first time; then keep that a person agreed to this stand file.

    Nobody is asked if nothing real moves, if a person agreed to this text of the stand file before, or if the
    commissioning of its drive is valid today. motion: what the motor will do. agree: None asks nobody and keeps
    nothing. Raises the errors of `agree`.
    """
    if agree is None or stand.stand.backend in NOTHING_TURNS:
        return
    memory = None
    with suppress(WrongUse, OSError):  # without a folder for it, nothing is kept and every run asks
        memory = StoredFacts(
            "agreed", str(stand.stand.backend), sha256(repr((stand.text, *emulation_of(stand))).encode()).hexdigest()
        )
        if memory.path.exists() or _is_commissioned(memory.path.parents[1], _drive_of(stand, mode)):
            return
    agree(f"{announcement(stand, motion)} hil asks this once for each stand file.")
    with suppress(WrongUse):
        if memory is not None:
            memory.keep({"time": time.time()})


def announcement(stand: Stand, motion: str) -> str:
    """Return what a person reads before the motor moves: which motor, on which port, and what it will do."""
    backend = str(stand.stand.backend)
    table = stand.devices.get(backend)
    place = ", ".join(f"{key} {getattr(table, key)}" for key in _PLACE if hasattr(table, key))
    return (
        f"The motor of {stand.stand.name!r} ({backend}{place and ', '}{place}) {motion} Lock the joint, take your "
        "hands off, and keep the emergency stop within reach."
    )


def _drive_of(stand: Stand, mode: Quantity) -> str:
    """Return a hash of what the stand file says of its drive: the same in all stand files with this drive and mode."""
    backend = str(stand.stand.backend)
    return sha256(repr((backend, stand.devices.get(backend), str(mode), *emulation_of(stand))).encode()).hexdigest()


def _is_commissioned(state: Path, drive: str) -> bool:
    """Return whether the folder `state` has a valid result for the drive with the hash `drive`. No drive is opened."""
    for path in (state / "commissioning").glob("*.json"):
        with suppress(OSError, ValueError, RecursionError, WrongUse):
            kept = StoredFacts("commissioning", path.stem).load() or {}
            found = _valid_today(kept)
            if found is not None and found.stops_ours and found.releases and kept.get("stand") == drive:
                return True
    return False


def permitted(stand: Stand, info: ServoInfo, profile: Profile) -> tuple[Stand, list[Diagnostic]]:
    """Return the stand with the torque limit that a run of `profile` may use, and a warning if this limit is halved.

    Raises WrongUse if the drive did not release its torque in the test and the stand file does not accept that, or if
    `profile` exceeds the limit.
    """
    if info.backend in NOTHING_TURNS or stand.stand.backend in NOTHING_TURNS:
        return stand, []
    require_release(stand, info, profile.mode)
    found = last_outcome(stand, info, profile.mode)
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
        f"nobody tested in the last {DAYS:.0f} days whether this drive stops when hil stops: the torque limit is now "
        f"{half:g} N m, half of the stand's; {remedy}",
    )
    return with_torque_limit(stand, half), [halved]


def require_release(stand: Stand, info: ServoInfo, mode: Quantity) -> None:
    """Raise WrongUse if the drive kept its torque in a test and has passed no test since, unless the stand file accepts
    that.
    """
    if stand.stand.torque_stays_on_if_host_dies or not _kept_torque(stand, info, mode):
        return
    raise WrongUse(
        "this drive kept its torque when no command arrived (hil doctor --commission), or the stored result of this "
        "test cannot be read. If this computer stops, the motor pulls until its power is cut. Nothing was driven: "
        "correct its watchdog and repeat the commissioning; or accept this with torque_stays_on_if_host_dies = true in "
        "[stand], and keep a switch for its power at hand"
    )


def with_torque_limit(stand: Stand, torque: float) -> Stand:
    """Return the stand with the torque limit `torque`, N m at the joint. Raises WrongUse if the stand sets no
    limits.
    """
    return replace(stand, limits=stand.checked_limits().model_copy(update={"torque": torque}))
