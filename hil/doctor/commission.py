"""Commissioning: trials of a drive under a small torque, and their result, without which `hil record` allows half the
torque only.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from drivers.servo import DriverError, Quantity, ServoInfo
from hil.acquisition.commissioning import DAYS, NOTHING_TURNS, SHARE, Commissioning, identity, with_torque_limit
from hil.doctor.checks import CheckList
from hil.doctor.trials import LOAD, EndedEarly, Trial, Try, make_trial, try_guardian, try_second_signal, try_silence
from hil.errors import Untrustworthy, WrongUse
from hil.stand.file import Stand

_TRIALS: tuple[tuple[str, str, Try], ...] = (
    ("second signal", "two signals to stop", try_second_signal),
    ("guardian", "torque-off by the guardian", try_guardian),
    ("watchdog", "no commands at all", try_silence),  # last, since it may leave a fault
)


_ATTEMPTS = 3


@dataclass(frozen=True, slots=True)
class Report:
    """The result of commissioning and its trials. guardian: the guardian's trial, None if the drive has no guardian."""

    outcome: Commissioning
    info: ServoInfo
    second_signal: Trial
    guardian: Trial | None
    watchdog: Trial

    @property
    def good(self) -> bool:
        """Return whether every tested way switched the drive's torque off."""
        return self.outcome.releases and self.outcome.stops_ours

    @property
    def verdict(self) -> str:
        """The result of commissioning in one line."""
        out = self.outcome
        if not out.releases:
            return (
                f"the drive DOES NOT RELEASE ITS TORQUE: {self.watchdog.seconds:.2g} s after its last command it still "
                f"showed {self.watchdog.left.words}. A crash of the computer leaves the torque on: keep the emergency "
                f"stop within reach; {_remedy(self.info)}"
            )
        if not out.stops_ours:
            failed = "the second signal" if not out.second_signal else "the guardian"
            return f"{failed} DID NOT SWITCH THE TORQUE OFF: do not drive this stand; look at the checks below"
        tried = "watchdog, guardian and second signal" if out.guardian else "watchdog and second signal"
        return f"commissioned until {out.until}: {tried} each switch the torque off; kept for {identity(self.info)}"

    def as_json(self) -> dict[str, object]:
        """Return the commissioning result as an object for the JSON of `hil doctor`."""
        trials = {"second_signal": self.second_signal, "guardian": self.guardian, "watchdog": self.watchdog}
        return {
            "ok": self.good,
            "verdict": self.verdict,
            "drive": identity(self.info),
            "valid_until": self.outcome.until if self.outcome.releases else None,
            "torque_share": LOAD,
        } | {name: None if trial is None else _as_json(trial) for name, trial in trials.items()}


def commission(checks: CheckList, stand: Stand, mode: Quantity, say: Callable[[str], object]) -> Report | None:
    """Make the trials and store their result. Return None if a trial could not be made: `checks` says why.

    The torque is off on return. say: called with a sentence before each trial. Raises WrongUse if the stand needs no
    commissioning or the result cannot be stored, and Untrustworthy if the trials give no clear result.
    """
    if stand.stand.backend in NOTHING_TURNS:
        raise WrongUse(
            f"backend {stand.stand.backend!r} drives no real motor, so it needs no commissioning: omit --commission"
        )
    reduced = _reduced(stand)
    made: dict[str, Trial | None] = {}
    for name, words, trial in _TRIALS:
        say(f"{LOAD * 100:.0f} % of the limit, then {words} ...")
        made[name] = _repeated(checks, reduced, mode, (name, trial))
        if checks.signal or not checks.ok:
            return None
    signalled, watched = made["second signal"], made["watchdog"]
    if checks.info is None or signalled is None or watched is None:
        return None
    return _kept(checks, stand, (checks.info, mode), (signalled, made["guardian"], watched))


def _repeated(checks: CheckList, stand: Stand, mode: Quantity, named: tuple[str, Try]) -> Trial | None:
    """Make a trial, once more if the run ended before the trial. named: name and function of the trial. Return None if
    no trial was made: `checks` says why.
    """
    name, trial = named
    reason = ""
    for _ in range(_ATTEMPTS):
        try:
            return make_trial(checks, stand, mode, name, trial)
        except EndedEarly as error:
            reason = str(error)
            if not checks.ok:
                return None
        except (DriverError, OSError) as error:
            reason = str(error)
            break
    checks.failed(name, f"the run ended before the trial: {reason}")
    return None


def _reduced(stand: Stand) -> Stand:
    """Return the stand for the trials: with half the torque limit; a drive without a watchdog is accepted."""
    table = stand.stand.model_copy(update={"torque_stays_on_if_host_dies": True})
    return with_torque_limit(replace(stand, stand=table), SHARE * stand.checked_limits().torque)


def _kept(
    checks: CheckList, stand: Stand, tried: tuple[ServoInfo, Quantity], trials: tuple[Trial, Trial | None, Trial]
) -> Report:
    """Store the result that follows from the trials, and return it. tried: the drive and its mode."""
    info, mode = tried
    signalled, guarded, watched = trials
    for name, trial in (("second signal", signalled), ("guardian", guarded), ("watchdog", watched)):
        if trial is not None:
            _check(checks, name, trial)
    if watched.left.releases is None:
        raise Untrustworthy(
            f"whether the drive releases its torque cannot be decided: after {watched.seconds:.2g} s without a command "
            f"it showed {watched.left.words}. No result was stored: raise limits.torque or add a "
            "torque cell"
        )
    outcome = Commissioning(
        time=time.time(),
        firmware=info.firmware,
        watchdog=info.watchdog,
        releases=watched.left.releases,
        guardian=None if guarded is None else bool(guarded.left.releases),
        second_signal=bool(signalled.left.releases) or not signalled.left.measured,
    )
    path = outcome.keep(stand, info, mode)
    how_long = f"for {DAYS:.0f} days" if outcome.releases else "until it passes"
    checks.passed("kept", f"for {identity(info)}, {how_long}, in {path}")
    return Report(outcome, info, signalled, guarded, watched)


def _check(checks: CheckList, name: str, trial: Trial) -> None:
    said = f"{trial.seconds * 1e3:.0f} ms later the drive showed {trial.left.words}"
    if trial.left.releases:
        checks.passed(name, said)
    else:
        checks.failed(name, said)


def _remedy(info: ServoInfo) -> str:
    if info.watchdog:
        return (
            f"its watchdog of {info.watchdog:g} s was on and the torque stayed: some drives hold a position when it "
            "acts, so use --mode torque; or try newer firmware; or accept this with "
            "torque_stays_on_if_host_dies = true in [stand]"
        )
    return info.watchdog_remedy or "this drive has no watchdog"


def _as_json(trial: Trial) -> dict[str, object]:
    share = trial.left.share
    return {
        "releases": trial.left.releases,
        "seconds": trial.seconds,
        "left": None if share != share else share,  # noqa: PLR0124 - JSON has no NaN
        "words": trial.left.words,
    }
