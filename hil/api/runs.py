"""One run on a real or simulated stand: check the excitation against the stand's limits, drive it and record."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.servo import DriverError, LinkLost, Quantity
from hil.acquisition import run as acquisition
from hil.acquisition.excitation import Profile, make
from hil.acquisition.phases import Outcome
from hil.api.wording import diagnostics_in_python, worded
from hil.diagnostics import Diagnostic, driven_by_position, lateness, over_limit
from hil.errors import Untrustworthy, WrongUse
from hil.guardian.handle import available
from hil.hand.file import load_stand
from hil.recording.reader import Recording
from hil.stand.devices import restrictions
from hil.stand.fault_file import load_plan
from hil.stand.file import SIMULATED, Stand, parse

if TYPE_CHECKING:
    from hil.api.recordings import LoadedRecording
    from sim_backend.fault_plan import FaultPlan

DEFAULT_RATE = 500.0
"""The sampling rate if none is given, Hz."""

_WITHOUT_HARDWARE = frozenset({"sim", "replay"})
_UNGUARDED = Diagnostic(
    "no-guardian",
    "there is no guardian: if hil is killed, frozen or late, only the drive's own watchdog switches the torque off. "
    "Nothing restores the settings of the drive. Leave out --no-guardian (Windows has no guardian)",
)
_FAST_MODE = 1e6  # rad/s; above this a simulated second takes about as long as a real one

AnyStand = str | os.PathLike[str] | Stand
"""The ways to name a stand: the path of a stand file, a loaded stand, or "sim" for the simulated stand."""


@dataclass(frozen=True, slots=True)
class Run:
    """A finished run and its recording; a Run can be used wherever the path of a recording is expected.

    path: of the recording. outcome: numbers of samples, lost replies and late ticks, and why the run ended.
    diagnostics: warnings and errors about the run; those about the recording's quality are shown by `hil inspect`.
    lateness: how late the set-points were sent, s: median, 99 % and largest; NaN if the recording has no such values.
    """

    path: Path
    outcome: Outcome
    diagnostics: tuple[Diagnostic, ...]
    lateness: tuple[float, float, float] = (math.nan, math.nan, math.nan)

    def __fspath__(self) -> str:
        return str(self.path)

    @property
    def trustworthy(self) -> bool:
        """Return whether the diagnostics contain no error."""
        return not any(diagnostic.is_error for diagnostic in self.diagnostics)

    def load(self) -> LoadedRecording:
        """Load and return the recording. Raises WrongUse, and Untrustworthy for a damaged file."""
        from hil.api.recordings import load

        return load(self.path)

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of `hil record --json`."""
        return {
            "schema": "hil-record/1",
            "recording": str(self.path) if self.outcome.samples else None,
            "samples": self.outcome.samples,
            "lost": self.outcome.lost,
            "late": self.outcome.late,
            "missed": self.outcome.missed,
            "lateness": [None if math.isnan(value) else value for value in self.lateness],
            "saturated": self.outcome.saturated,
            "end_reason": self.outcome.end_reason,
            "warnings": [one.as_json() for one in self.diagnostics],
        }


@worded
def record(
    stand: AnyStand,
    profile: str = "chirp",
    *,
    joint: str | None = None,
    amplitude: float | None = None,
    band: tuple[float, float] | None = None,
    duration: float | None = None,
    rate: float = DEFAULT_RATE,
    mode: Quantity | str = Quantity.TORQUE,
    fade: float = 1.0,
    setpoints: str | os.PathLike[str] | None = None,
    seed: int = 0,
    realtime: bool = False,
    note: str = "",
    output: str | os.PathLike[str] | None = None,
    force: bool = False,
    guardian: bool = True,
    faults: str | os.PathLike[str] | None = None,
    rerun: str = "",
    command_line: str = "",
    warn: Callable[[Sequence[Diagnostic]], object] | None = None,
    alarm: Callable[[str], object] | None = None,
    agree: Callable[[str], object] | None = None,
    ended: Callable[[Run], object] | None = None,
) -> Run:
    """Drive the motor of `stand` through an excitation against the locked joint, and record it.

    joint: its name in the file of a hand. amplitude: N m or rad at the joint (None: a fifth of the stand's limit).
    band: Hz. duration: s. rate: Hz. mode: "torque" or "position". fade: duration of the raised-cosine start and stop,
    s. setpoints: CSV for profile "file". seed: for everything random. realtime: simulate in wall time. note,
    command_line: texts stored in the recording. output: its path (None: the next free recordings/runN.h5). force:
    replace a file. guardian: whether a second process switches a real drive's torque off if this one is killed, frozen
    or late. faults: a TOML file with planned faults of a simulated stand. rerun: "window" or a file .rrd. warn: called
    with the warnings known before anything moves. alarm: called at once if the torque may still be on. agree: called
    before a real motor first moves; raises to refuse. ended: called with the run before its fault is raised.
    The torque is off on return, and all rows are kept. Ctrl-C ramps the torque to zero and sets `outcome.signal`.
    Raises WrongUse before any motion, DriverError if the drive fails, `LimitReached` at a limit.
    """
    opened, shape = opened_stand(stand, joint), (quantity_of(mode), (amplitude, band, duration))
    made = excitation(opened, profile, *shape, rate=rate, setpoints=setpoints, fade=fade, seed=seed)
    foreseen = _warned(_foreseen(opened, made, guardian=guardian), warn)
    recorded = acquisition.run(
        opened,
        made,
        rate=rate,
        seed=seed,
        realtime=realtime,
        note=note,
        command_line=command_line,
        output=None if output is None else Path(output),
        force=force,
        guardian=guardian,
        rerun=rerun,
        alarm=alarm,
        faults=None if faults is None else _plan(opened, Path(faults)),
        warn=lambda found: foreseen.extend(_warned(found, warn)),
        agree=agree,
    )
    return _reported(*recorded, foreseen, ended)


def _warned(foreseen: list[Diagnostic], warn: Callable[[Sequence[Diagnostic]], object] | None) -> list[Diagnostic]:
    """Call `warn` with the warnings that are known before the run; return these warnings."""
    if foreseen and warn is not None:
        warn(diagnostics_in_python(tuple(foreseen)))
    return foreseen


def _reported(
    path: Path, outcome: Outcome, foreseen: Sequence[Diagnostic], ended: Callable[[Run], object] | None
) -> Run:
    """Call `ended` with the run, then return the run. Raises the fault that ended the run."""
    moved = [Diagnostic("file-moved", outcome.moved)] if outcome.moved else []
    late = lateness(outcome.late, outcome.samples)
    over = [over_limit(text) for text in outcome.exceeded]
    said = diagnostics_in_python((*foreseen, *moved, *late, *over))
    run = Run(path, outcome, said, _stored_lateness(path, outcome.samples))
    try:
        if ended is not None:
            ended(run)
    finally:
        _raise_fault(run.outcome)
    return run


def _stored_lateness(path: Path, samples: int) -> tuple[float, float, float]:
    """Return the lateness of a recording's set-points, s: median, 99 % and largest; NaN if the recording is
    unfinished.
    """
    stored: Mapping[str, Any] = {}
    if samples:
        with suppress(WrongUse, Untrustworthy, OSError), Recording(path) as recording:
            stored = recording.attributes
    median, most, largest = (float(stored.get(f"lateness_{which}", math.nan)) for which in ("p50", "p99", "max"))
    return median, most, largest


def _plan(stand: Stand, path: Path) -> FaultPlan:
    if stand.stand.backend != "sim":
        raise WrongUse(
            f"--faults {path}: faults are planned for --backend sim; an emulated drive has its own, with "
            "`hil emulate NAME --faults FILE`"
        )
    return load_plan(path)


@worded
def simulate(
    output: str | os.PathLike[str] | None = None,
    profile: str = "chirp",
    *,
    sim: Mapping[str, Mapping[str, float | bool | str]] | None = None,
    amplitude: float | None = None,
    band: tuple[float, float] | None = None,
    duration: float | None = None,
    rate: float = DEFAULT_RATE,
    mode: Quantity | str = Quantity.TORQUE,
    fade: float = 1.0,
    seed: int = 0,
    note: str = "",
    force: bool = False,
) -> Run:
    """Record an excitation on the simulated stand, in virtual time.

    sim: the tables of [sim] in a stand file (docs/simulator.md) with values in SI or texts with a unit, such as
    {"coupling": {"stiffness": 0.02}}. The other arguments are those of `record`. Raises WrongUse, for `sim` with all
    its unknown or impossible keys.
    """
    return record(
        parse(SIMULATED + _toml(sim or {}), "sim"),
        profile,
        amplitude=amplitude,
        band=band,
        duration=duration,
        rate=rate,
        mode=mode,
        fade=fade,
        seed=seed,
        note=note,
        output=output,
        force=force,
    )


def _toml(sim: Mapping[str, Mapping[str, float | bool | str]]) -> str:
    """Return tables of numbers, truth values and texts as TOML."""
    return "".join(
        f"\n[sim.{table}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())
        for table, values in sim.items()
    )


def opened_stand(stand: AnyStand, joint: str | None = None) -> Stand:
    """Return the stand in a stand file, that of a joint in the file of a hand, or the simulated stand for "sim". Raises
    WrongUse.
    """
    if isinstance(stand, Stand):
        return stand
    return parse(SIMULATED) if stand == "sim" else load_stand(Path(stand), joint)


def quantity_of(mode: Quantity | str) -> Quantity:
    """Return the quantity of the mode "torque" or "position". Raises WrongUse for another word."""
    try:
        return Quantity(mode)
    except ValueError:
        raise WrongUse(f"--mode {mode!r}: it is {' or '.join(Quantity)}") from None


Size = tuple[float | None, tuple[float, float] | None, float | None]
"""Amplitude (N m or rad at the joint), band (Hz) and duration (s) of an excitation. None means the default value."""


def excitation(
    stand: Stand,
    profile: str,
    mode: Quantity,
    size: Size,
    *,
    rate: float,
    setpoints: str | os.PathLike[str] | None,
    fade: float = 1.0,
    seed: int = 0,
) -> Profile:
    """Return the checked excitation for a stand; its default amplitude is a fifth of the stand's limit. Raises
    WrongUse.

    size: amplitude, band and duration. rate: sampling rate, Hz. setpoints: path of a CSV with set-points. fade:
    duration of start and stop, s. seed: for the random part.
    """
    if not 20.0 <= rate <= 10_000.0:
        raise WrongUse(
            f"--rate {rate:g}: it must lie between 20 and 10000 Hz; a drive that is asked less often assumes that its "
            "host is dead and turns the torque off"
        )
    amplitude, band, duration = size
    return make(
        profile,
        mode,
        amplitude=amplitude,
        default_amplitude=_limit_of(stand, mode) / 5.0,
        duration=duration,
        band=band,
        rate=rate,
        fade=fade,
        seed=seed,
        setpoints=None if setpoints is None else Path(setpoints),
    )


def _limit_of(stand: Stand, mode: Quantity) -> float:
    """Return the stand's limit on torque, N m, or deflection, rad, at the joint, whichever `mode` commands. Raises
    WrongUse if the stand has no limits.
    """
    limits = stand.checked_limits()
    return limits.torque if mode is Quantity.TORQUE else limits.deflection


def _check_amplitude(stand: Stand, profile: Profile) -> None:
    limit = _limit_of(stand, profile.mode)
    unit, small, factor = ("N m", "mN*m", 1e-3) if profile.mode is Quantity.TORQUE else ("rad", "deg", math.pi / 180.0)
    if profile.amplitude > limit:
        meant = f"write '{profile.amplitude:g} {small}' if you mean that, or "
        raise WrongUse(
            f"--amplitude {profile.amplitude:g} {unit} is beyond the stand's limit of {limit:g} {unit}: "
            f"{meant if profile.amplitude * factor <= limit else ''}lower it; no option raises a limit"
        )


def _foreseen(stand: Stand, profile: Profile, *, guardian: bool) -> list[Diagnostic]:
    """Return the warnings about a run that are known before anything moves. Raises WrongUse for an amplitude beyond the
    stand's limit.
    """
    _check_amplitude(stand, profile)
    found = []
    if stand.stand.torque_source == "motor" and profile.mode is Quantity.POSITION:
        found.append(driven_by_position(is_error=False))
    found += stand.calibration_diagnostics(datetime.now(UTC))
    table = stand.devices.get(str(stand.stand.backend))
    found += [Diagnostic("restricted-drive", text) for text in restrictions(table, stand.stand.torque_source)]
    if stand.stand.backend not in _WITHOUT_HARDWARE and not (guardian and available()):
        found.append(_UNGUARDED)
    if stand.stand.backend != "sim":
        return found
    from sim_backend.plant import constants, fastest_rate

    rate = fastest_rate(constants(stand.simulated()))  # the integrator's steps follow the fastest mode
    if rate > _FAST_MODE:
        found.append(
            Diagnostic(
                "slow-simulation",
                f"the fastest mode of the simulated stand lies at {rate / 6283.0:.0f} kHz, so that every simulated "
                f"second takes about {rate:.0e} steps: lower fixture.stiffness or raise the inertias",
            )
        )
    return found


def _raise_fault(outcome: Outcome) -> None:
    """Raise the fault that ended the run. If the torque may still be on, the end of the message says so."""
    if outcome.alarm:
        raise DriverError(f"{outcome.error}\n{outcome.alarm}") from outcome.error
    if isinstance(outcome.error, OSError) and not isinstance(outcome.error, DriverError):
        raise LinkLost(f"the link failed: {outcome.error}") from outcome.error
    if outcome.error is not None:
        raise outcome.error
