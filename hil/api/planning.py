"""The design of an experiment: the predicted errors of Kc and Bc for an excitation, and the best excitation."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.servo import Quantity
from hil.api.runs import DEFAULT_RATE, AnyStand, excitation, opened_stand, quantity_of
from hil.api.wording import diagnostics_in_python, worded
from hil.diagnostics import Diagnostic
from hil.experiment_design import advice
from hil.experiment_design.assessment import Assessment, Task, assess, check_limits, task_of
from hil.experiment_design.search import best
from hil.printable import quoted
from hil.recording.ahead import Progress
from hil.report.design import as_json, headline
from hil.stand.file import Stand


@dataclass(frozen=True, slots=True)
class DesignResult:
    """The result of `design`: the predicted errors for two excitations. `str(result)` is the answer in one line.

    task: the joint, its sensors and limits. judged: the assessments of the requested excitation, "given", and of the
    excitation with the smallest errors, "best". stand: the command-line option that names the stand. general: the
    warnings that apply to every excitation.
    """

    task: Task
    judged: Mapping[str, Assessment]
    stand: str
    general: tuple[Diagnostic, ...]

    def __repr__(self) -> str:
        return f"<{self}>"

    def __str__(self) -> str:
        return headline(self.judged)

    @property
    def given(self) -> Assessment:
        """The assessment of the requested excitation."""
        return self.judged["given"]

    @property
    def best(self) -> Assessment:
        """The assessment of the excitation with the smallest errors."""
        return self.judged["best"]

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """All warnings: first the general warnings, then those about one excitation."""
        own = (warning for one in self.judged.values() for warning in advice.of_profile(self.task, one))
        return diagnostics_in_python((*self.general, *own))

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of `hil design --json`."""
        return as_json(self.task, self.judged, list(self.general), self.stand)


@worded
def design(
    stand: AnyStand,
    profile: str = "chirp",
    *,
    joint: str | None = None,
    kc: float | None = None,
    bc: float | None = None,
    torque_noise: float | None = None,
    amplitude: float | None = None,
    band: tuple[float, float] | None = None,
    duration: float | None = None,
    rate: float = DEFAULT_RATE,
    mode: Quantity | str = Quantity.TORQUE,
    setpoints: str | os.PathLike[str] | None = None,
    model: str = "auto",
    progress: Progress | None = None,
) -> DesignResult:
    """Predict the errors of Kc and Bc for an excitation, and find the excitation with the smallest errors. Nothing
    moves.

    kc, bc: rough values of the joint, N m/rad and N m s/rad; None: the values in [sim], for a simulated stand only.
    torque_noise: standard deviation of the torque reading at the joint, N m; None: the value in [sim]. model: the terms
    to estimate, or "auto": the common terms of model selection. progress: called with the name of the present step
    and the completed fraction. The other arguments are those of `hil.record`. Raises WrongUse, also if the excitation
    would exceed a limit of the stand.
    """
    opened, quantity = opened_stand(stand, joint), quantity_of(mode)
    made = excitation(opened, profile, quantity, (amplitude, band, duration), rate=rate, setpoints=setpoints)
    task = task_of(opened, kc=kc, bc=bc, torque_noise=torque_noise, model=model, mode=quantity, rate=rate)
    given = assess(task, made)
    check_limits(task, given)
    stated = torque_noise is not None or opened.stand.backend == "sim" or "[sim.sensors]" in opened.text
    judged = {"given": given, "best": best(task, made.duration, progress)}
    return DesignResult(task, judged, _words(stand, joint), tuple(advice.of_task(task, noise_stated=stated)))


def _words(stand: AnyStand, joint: str | None) -> str:
    """Return the command-line option that names the stand."""
    if stand == "sim":
        return "--backend sim"
    words = f"--stand {'stand.toml' if isinstance(stand, Stand) else quoted(Path(stand))}"
    return words if joint is None else f"{words} --joint {joint}"
