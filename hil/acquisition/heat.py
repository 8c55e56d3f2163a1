"""The heat limit of a run: the winding's temperature is predicted before the run and estimated during the run.

The estimate needs no temperature sensor, so it ends a run in time even if the sensor's reading is stale. The estimate
is stored in a file for each drive. The next run starts from the stored temperature, less the cooling since then. The
cooling time is measured by a clock that nobody can set, or by the time of day if the computer was restarted meanwhile.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np

from drivers.servo import Quantity, Sample, ServoInfo
from hil.acquisition.drive_memory import StoredFacts
from hil.acquisition.excitation import Profile
from hil.acquisition.limits import AtJoint, LimitReached
from hil.errors import WrongUse
from hil.recording.posix import since_boot
from hil.stand.file import Stand
from hil.stand.winding import Temperatures, WindingModel

_MARGIN = 5.0  # degC below the limit, at which a run is refused or ended
_STEP, _BLOCK = 5e-3, 20  # s between two torques of a prediction, and how many of them heat together
_LONGEST_REST = 1e6  # s, after which any motor is cold
_SPARE, _SHORTEST, _HALVINGS = 0.98, 1.0, 12  # share of what fits that is proposed; s; steps to the amplitude
_HOTTEST = 1000.0  # degC that a state file may state


class TooHot(LimitReached):
    """The run was refused before anything moved, because the winding would become too hot.

    rest: waiting time, s, after which the run may begin; infinite if even a cold motor would get too hot.
    """

    def __init__(self, message: str, rest: float) -> None:
        super().__init__(message)
        self.rest = rest


class HeatMemory:
    """The file that keeps the winding's temperature of the drive `info` of `stand` between two runs.

    Raises WrongUse if the file cannot be read or written.
    """

    def __init__(self, stand: Stand, info: ServoInfo) -> None:
        self._memory = StoredFacts.of_drive("heat", stand, info)

    def load(self, model: WindingModel, now: float) -> Temperatures:
        """Return the temperatures at `now`, s since 1970: those at the end of the last run, after the cooling since
        then.
        """
        try:
            kept = self._memory.load()
            if kept is None:
                return model.cold
            state = Temperatures(float(kept["winding_degC"]), float(kept["case_degC"]))
            rested = now - float(kept["time"])
            boot, awake = since_boot()
            if boot and kept.get("boot") == boot:  # the time of day may have been set forward meanwhile
                rested = min(rested, awake - float(kept["since_boot"]))
            if not (all(abs(value) < _HOTTEST for value in state) and math.isfinite(rested)):
                raise ValueError("it has impossible numbers")
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError, WrongUse) as error:
            raise WrongUse(
                f"the winding's temperature in {self._memory.path} is unreadable ({error}): let the motor cool down, "
                "then delete the file"
            ) from None
        return model.after(state, 0.0, max(0.0, rested))

    def keep(self, state: Temperatures, at: float) -> None:
        """Store the temperatures `state` for the time `at`, s since 1970. Raises WrongUse."""
        boot, awake = since_boot()
        times = {"time": at, "boot": boot, "since_boot": awake + at - time.time()}
        self._memory.keep(times | {"winding_degC": state.winding, "case_degC": state.case})


class WindingHeat:
    """The limit on the winding's estimated temperature.

    model: thermal model of the motor. limit: highest allowed temperature, degC. gear: motor turns for one joint turn.
    planned: mean square torques of the coming run at the motor shaft, (N m)^2, one for each block of `_STEP * _BLOCK`
    s. longest: the torque, N m, that is assumed if no torque is measured. amplitude: of the profile, N m at the joint.
    memory: the file with the temperatures of the last run; None for a simulated motor, which starts cold.
    """

    name = "winding"

    def __init__(
        self,
        model: WindingModel,
        limit: float,
        gear: float,
        planned: Sequence[float],
        *,
        longest: float,
        amplitude: float,
        memory: HeatMemory | None = None,
    ) -> None:
        self._model, self._limit, self._gear = model, limit, gear
        self._planned, self._longest, self._memory = planned, longest, memory
        self._amplitude = amplitude
        self._t = math.nan
        self.state = model.cold

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Begin the estimate at the stored temperature, or at the reported one if that is higher. Raises TooHot."""
        del at_joint
        if self._memory is not None:
            self.state = self._memory.load(self._model, time.time())
        shown = [sample.temperature for sample in samples if math.isfinite(sample.temperature)]
        if shown:
            self.state = Temperatures(*(max(value, shown[-1]) for value in self.state))
        self._t = samples[-1].t if samples else math.nan
        end = self._predicted()
        if self._memory is not None:  # a run that is killed leaves the hotter of what it began and was to end with
            self._memory.keep(max(self.state, end), time.time() + len(self._planned) * _STEP * _BLOCK)

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Update the estimate with one reply of the drive. Raises LimitReached if the winding is too hot."""
        passed, self._t = sample.t - self._t, sample.t
        torque = sample.motor_torque if math.isfinite(sample.motor_torque) else at_joint.torque / self._gear
        torque = torque if math.isfinite(torque) else self._longest
        if passed > 0.0:
            self.state = self._model.after(self.state, torque * torque, passed)
        if self.state.winding > self._limit - _MARGIN:
            raise LimitReached(
                f"the winding is estimated at {self.state.winding:.0f} degC; its limit is {self._limit:g}: let it cool "
                "down, lower --amplitude, or correct [winding]"
            )

    def keep(self) -> None:
        """Store the temperatures for the next run. If the run never began, store nothing. Raises WrongUse."""
        if self._memory is not None and math.isfinite(self._t):
            self._memory.keep(self.state, time.time())

    def _predicted(self) -> Temperatures:
        """Return the predicted temperatures at the end of the run. Raises TooHot if they would exceed the limit."""
        end, after = self._driven(self.state)
        if after is not None:
            self._refuse(after)
        return end

    def _driven(self, state: Temperatures, share: float = 1.0) -> tuple[Temperatures, float | None]:
        """Return the temperatures at the end of a run that begins at `state`, and the time, s, at which they exceed the
        limit (None: never).

        share: factor on the planned torques.
        """
        for block, square in enumerate(self._planned):
            state = self._model.after(state, share * share * square, _STEP * _BLOCK)
            if state.winding > self._limit - _MARGIN:
                return state, block * _STEP * _BLOCK
        return state, None

    def _rest(self) -> float:
        """Return the time that the motor must rest before the run, s; infinite if the run would overheat even a cold
        motor.
        """
        if self._driven(self._model.cold)[1] is not None:
            return math.inf
        short, enough = 0.0, 1.0
        while enough < _LONGEST_REST and self._driven(self._model.after(self.state, 0.0, enough))[1] is not None:
            short, enough = enough, 2.0 * enough
        while enough - short > 1.0:
            middle = 0.5 * (short + enough)
            is_enough = self._driven(self._model.after(self.state, 0.0, middle))[1] is None
            short, enough = (short, middle) if is_enough else (middle, enough)
        return enough

    def _refuse(self, after: float) -> None:
        now, rest = f"It is at {self.state.winding:.0f} degC now", self._rest()
        cool = (
            "it is too much for a cold motor too: " if math.isinf(rest) else f"let it cool down for {rest:.0f} s, or "
        )
        raise TooHot(
            f"the winding would reach {self._limit - _MARGIN:.0f} degC after {after:.3g} s, too near its limit of "
            f"{self._limit:g}: nothing was driven. {now}; {cool}{' or '.join(self._remedies(after))}",
            rest,
        )

    def _remedies(self, after: float) -> list[str]:
        """Return the options with which the run would be allowed: the longest duration, the largest amplitude. after:
        time, s, after which the planned run would be too hot.
        """
        duration, amplitude = _SPARE * after, _SPARE * self._amplitude * self._share_that_fits()
        shorter = [f"add --duration {_rounded_down(duration)}"] if duration >= _SHORTEST else []
        return [*shorter, f"add --amplitude {_rounded_down(amplitude)}" if amplitude > 0.0 else "wait longer"]

    def _share_that_fits(self) -> float:
        """Return the factor on the torques, below 1, with which the whole run stays below the temperature limit."""
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            fits = self._driven(self.state, middle)[1] is None
            low, high = (middle, high) if fits else (low, middle)
        return low


def _rounded_down(value: float) -> str:
    """Return a positive number rounded down to two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.floor(value / unit + 1e-9) * unit:.2g}" if value < 100.0 else f"{math.floor(value)}"


def heat_budget(stand: Stand, info: ServoInfo, profile: Profile) -> WindingHeat | None:
    """Return the heat limit for a run of `profile`, None if the stand has no [winding].

    The torque of a profile of positions cannot be predicted: its heat is estimated during the run only.
    """
    if stand.winding is None:
        return None
    limits, gear = stand.checked_limits(), stand.stand.gear_ratio
    model = stand.winding.model(limits.temperature)
    planned = _mean_squares(profile, gear) if profile.mode is Quantity.TORQUE else []
    memory = None if stand.stand.backend in {"sim", "replay"} else HeatMemory(stand, info)
    return WindingHeat(
        model,
        limits.temperature,
        gear,
        planned,
        longest=limits.torque / gear,
        amplitude=profile.amplitude,
        memory=memory,
    )


def _mean_squares(profile: Profile, gear: float) -> list[float]:
    """Return the mean squares of the torque at the motor shaft, (N m)^2, one for each block of the profile."""
    out: list[float] = []
    blocks = math.ceil(profile.duration / (_STEP * _BLOCK))
    for first in range(0, blocks, 1000):
        count = min(1000, blocks - first)
        times = (first * _BLOCK + np.arange(count * _BLOCK)) * _STEP
        torque = np.asarray(profile.at(np.minimum(times, profile.duration))) / gear
        out += np.mean(np.square(torque).reshape(count, _BLOCK), axis=1).tolist()
    return out
