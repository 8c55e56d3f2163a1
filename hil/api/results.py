"""The results of `hil.identify` and `hil.compare`: numbers, tables, pictures and reports.

Modules that only reports and pictures need are imported in their functions: that saves a tenth of the start of `hil
identify`.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hil.api.wording import diagnostics_in_python, in_python, worded
from hil.diagnostics import Diagnostic
from hil.errors import Untrustworthy
from hil.identification.compare import Comparison, Repeated
from hil.identification.result import Estimate, Identification
from hil.report import identification as identification_report
from hil.report import identification_json
from hil.report.controller import PHASE_MARGIN, Controller, controller

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.identification.misfit.dynamic_stiffness import DynamicStiffness

AnyPath = str | os.PathLike[str]


@dataclass(frozen=True, slots=True)
class IdentificationResult:
    """The result of `identify`: Kc, Bc and the other parameters of the model.

    `str(result)` is the answer in one line, `result["Kc"]` is one parameter. identification: all numbers and signals of
    the result. labels: a pandas Series with the index of the data frame that was identified, None if there is none.
    """

    identification: Identification
    labels: Any = field(default=None, repr=False, compare=False)

    def __getitem__(self, name: str) -> Estimate:
        try:
            return self.parameters[name]
        except KeyError:
            raise KeyError(f"no parameter {name!r}; the model has {', '.join(self.parameters)}") from None

    def __str__(self) -> str:
        return identification_report.headline(self.identification)

    def __repr__(self) -> str:
        return f"<{self}; {self.model}>"

    @property
    def parameters(self) -> Mapping[str, Estimate]:
        """The parameters by name, each with its value, unit and 95 % interval, SI."""
        return MappingProxyType({estimate.name: estimate for estimate in self.identification.estimates})

    @property
    def model(self) -> str:
        """The name of the model: its terms joined with +."""
        return self.identification.model.name

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """The warnings and errors about the result, each with a remedy."""
        return diagnostics_in_python(self.identification.diagnostics)

    @property
    def trustworthy(self) -> bool:
        """Return whether the diagnostics contain no error."""
        return self.identification.trustworthy

    def trusted(self, name: str) -> bool:
        """Return whether a parameter, "Kc" or "Bc", may be trusted: the data identifies it, and no error is about
        it.
        """
        return self.identification.trusted(name)

    @property
    def interrupted(self) -> bool:
        """Return whether Ctrl-C ended the search early; then the result is the best that the search had reached."""
        return self.identification.trials.interrupted

    @property
    def dynamic_stiffness(self) -> DynamicStiffness | None:
        """Stiffness and damping over frequency, estimated without a model; None if the recording is too short."""
        return self.identification.dynamic_stiffness

    @property
    def covariance(self) -> NDArray[np.float64]:
        """The covariance (p, p) of the parameters, in the order of `parameters`, SI; Kc and Bc are the first two.

        Its diagonal holds the squares of `stderr`. A parameter that is not known has infinite or NaN entries.
        """
        return self.identification.covariance

    def controller(self, phase_margin: float = PHASE_MARGIN) -> Controller | None:
        """Return corner frequency, resonance and stiffest position loop with their intervals (docs/controller.md).

        phase_margin: of that loop, rad. None if Kc or Bc may not be trusted. Raises WrongUse.
        """
        return controller(self.identification, phase_margin)

    @property
    def params(self) -> dict[str, float]:
        """The values of the parameters by name, SI."""
        return {name: one.value for name, one in self.parameters.items()}

    def conf_int(self) -> dict[str, tuple[float, float]]:
        """Return the lower and upper end of each parameter's 95 % interval by name, SI.

        `pandas.DataFrame.from_dict(result.conf_int(), orient="index")` is the table of statsmodels.
        """
        return {name: one.ci95 for name, one in self.parameters.items()}

    @property
    def rows(self) -> NDArray[np.int64]:
        """The row of the recording or frame for each of `residuals` (n,), counted from the first row that was taken."""
        return self.identification.signals.row

    @property
    def predicted(self) -> Any:
        """The model's torque at the joint (n,), N m, for each row that was used.

        An array, or a pandas Series with the index of these rows if a data frame of pandas was identified.
        """
        from hil.report.pictures.traces import modelled

        return self._labelled(modelled(self.identification))

    @worded
    def predict(self, recording: Any = None) -> Any:
        """Return the model's torque (n,), N m, for the motion of another recording or data frame, as `predicted` does.

        None: the one that was identified. The rows are those that `identify` would use. Raises WrongUse, and
        Untrustworthy for a recording without usable rows.
        """
        if recording is None:
            return self.predicted
        from hil.api.given import signals_of

        signals, labels = signals_of(recording)
        other = replace(self.identification, signals=signals.counted_from(self.identification.reference))
        return IdentificationResult(other, labels).predicted

    @property
    def residuals(self) -> Any:
        """Measured torque minus the model's torque (n,), N m, for each row that was used; a Series as `predicted`."""
        from hil.report.pictures.traces import modelled

        return self._labelled(self.identification.signals.torque - modelled(self.identification))

    def _labelled(self, values: NDArray[np.float64]) -> Any:
        if self.labels is None:
            return values
        return type(self.labels)(values, index=self.labels.index[self.rows], name="torque")

    @property
    def digest(self) -> str:
        """A SHA-256, hex, of the torque that was used, the options, every number of `as_json` and the diagnostics'
        codes.

        Equal for the same recording and options, on any number of workers and wherever the file lies: another digest
        means another result. A version of hil that finds the same numbers gives the same digest; another kind of
        processor may differ in the last digits.
        """
        found = self.identification
        fixture = found.fixture and replace(found.fixture, recording=Path())
        codes = [(one.code, one.parameter, one.is_error) for one in found.diagnostics]
        plain = replace(found, recordings=(), seconds=0.0, fixture=fixture, diagnostics=())
        text = json.dumps([identification_json.as_json(plain), codes], sort_keys=True)
        return hashlib.sha256(text.encode() + np.ascontiguousarray(found.signals.torque).tobytes()).hexdigest()

    def summary(self) -> str:
        """Return the answer, the table of the parameters, the warnings and the quality of the fit as text."""
        from hil.report.html_page import table_lines

        said = (f"{one.severity} [{one.code}]: {one.message}" for one in self.diagnostics)
        lines = map(in_python, identification_report.identification_lines(self.identification))
        return "\n".join([str(self), *table_lines(self._table), *said, *lines])

    def _repr_html_(self) -> str:
        """Return the answer and the table of the parameters for a notebook."""
        rows = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in self._table)
        table = "".join(f"<tr>{row}</tr>" for row in rows)
        said = "".join(f"<p>{escape(f'{one.severity}: {one.message}')}</p>" for one in self.diagnostics)
        return f"<p><b>{escape(str(self))}</b></p><table>{table}</table>{said}"

    @property
    def _table(self) -> Sequence[Sequence[str]]:
        return identification_report.estimates_section(self.identification).rows

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of `hil identify --json`."""
        return identification_json.as_json(self.identification)

    def plot(self) -> Figure:
        """Return a figure: measured and modelled torque, residuals, the torque-deflection loop and the diagnostic
        checks.
        """
        from hil.report.pictures import result

        return result.figure(self.identification)

    @worded
    def report(self, path: AnyPath, command: str = "", *, force: bool = True) -> Path:
        """Write the HTML report to `path` and return the path. Raises WrongUse.

        command: the command or script that made the result, printed in the report. force: replace an existing file.
        """
        from hil.report import identification_page

        return identification_page.write_page(self.identification, Path(path), command, force=force)

    @worded
    def save_plots(self, folder: AnyPath, *, force: bool = False) -> list[Path]:
        """Write every picture of the report as a PNG into a folder, and return their paths. Raises WrongUse."""
        from hil.report.pictures import files, result

        return files.write_pictures(result.pictures(self.identification), Path(folder), force=force)


class NoResult(Untrustworthy):
    """The error for recordings from which nothing could be identified; the message says why."""

    def __init__(self, reason: str, recordings: Sequence[Path], model: str, preset: str, seed: int) -> None:
        super().__init__(reason)
        self.recordings, self.model, self.preset, self.seed = tuple(recordings), model, preset, seed

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of `hil identify --json` for a failure: every value is null."""
        return identification_json.unusable_json(self.recordings, self.model, self.preset, self.seed, str(self))

    @worded
    def report(self, path: AnyPath, command: str = "", *, force: bool = True) -> Path:
        """Write an HTML report that says why there is no result, and return its path. Raises WrongUse.

        command: the command or script that was run. force: replace an existing file.
        """
        from hil.report import identification_page

        return identification_page.write_failure(
            str(self), self.recordings, self.as_json(), Path(path), command, force=force
        )


@dataclass(frozen=True, slots=True)
class ComparisonResult:
    """The result of `compare`: Kc and Bc of several recordings. `str(result)` is the answer in one line.

    comparison: all numbers of the result.
    """

    comparison: Comparison

    def __getitem__(self, name: str) -> Repeated:
        return next(parameter for parameter in self.comparison.parameters if parameter.name == name)

    def __repr__(self) -> str:
        return f"<comparison of {len(self.comparison.recordings)} recordings, {self.comparison.model}: {self}>"

    def __str__(self) -> str:
        return "\n".join(parameter.verdict for parameter in self.comparison.parameters)

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """The warnings and errors about the comparison, each with a remedy."""
        return diagnostics_in_python(self.comparison.diagnostics)

    @property
    def trustworthy(self) -> bool:
        """Return whether the diagnostics contain no error."""
        return self.comparison.trustworthy

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of `hil compare --json`."""
        from hil.report import comparison

        return comparison.as_json(self.comparison)

    def plot(self) -> Figure:
        """Return a figure: each parameter over the recordings with its interval, and the interval of all recordings
        together.
        """
        from hil.report import comparison
        from hil.report.pictures import canvas

        return canvas.drawn(comparison.chart(self.comparison))

    @worded
    def report(self, path: AnyPath, command: str = "", *, force: bool = True) -> Path:
        """Write the HTML report to `path` and return the path. Raises WrongUse.

        command: the command or script that made the result, printed in the report. force: replace an existing file.
        """
        from hil.report import comparison

        return comparison.write_page(self.comparison, Path(path), command, force=force)
