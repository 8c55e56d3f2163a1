"""The pictures of a recording and of an identification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from hil.errors import WrongUse
from hil.recording.output import atomic_write, check_output, writing
from hil.report.chart import Chart, Line, Panel
from hil.report.formatting import people_unit
from hil.report.html_page import Picture
from hil.report.identification import headline, milli, printed
from hil.report.lack_of_fit import draw_correlation, draw_dynamic_stiffness, draw_plane

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hil.identification.result import Estimate, Identification

Array = NDArray[np.float64]

_SHOWN: Final = 300  # stretches of a recording in the pictures of a page
_CHARTED: Final = 1200  # stretches of it in the charts, which can be zoomed
_LOOP: Final = 1200  # samples of the loop in the pictures of a page


@dataclass(frozen=True, slots=True)
class _Shown:
    """Arrays (n,) as people read them: torques in `unit`, time s, deflection rad; NaN where a line is interrupted."""

    time: Array
    measured: Array
    modelled: Array
    residuals: Array
    dtheta: Array
    unit: str
    model: str

    def thinned(self, number: int) -> _Shown:
        """The highest and the lowest residual of each of `number` stretches, so that a page is light to load."""
        count = len(self.time)
        if count <= 2 * number:
            return self
        stretches = np.array_split(np.arange(count), number)
        residuals = np.nan_to_num(self.residuals)
        ends = [(one[residuals[one].argmin()], one[residuals[one].argmax()]) for one in stretches]
        return self._of(np.unique(np.concatenate([np.ravel(ends), np.flatnonzero(np.isnan(self.time))])))

    def strided(self) -> _Shown:
        """Every n-th sample, at most `_LOOP` of them, and the interruptions."""
        every = np.arange(0, len(self.time), -(-len(self.time) // _LOOP))
        return self._of(np.union1d(every, np.flatnonzero(np.isnan(self.time))))

    def _of(self, kept: NDArray[np.intp]) -> _Shown:
        names = ("time", "measured", "modelled", "residuals", "dtheta")
        return replace(self, **{name: getattr(self, name)[kept] for name in names})


def _shown(found: Identification) -> _Shown:
    motion, torque, model = found.signals.motion, found.signals.torque, _modelled(found)
    factor, unit = people_unit("N*m", milli=milli(found))
    time, measured, modelled, residuals, dtheta = (
        _broken(values, motion.starts)
        for values in (motion.time, torque * factor, model * factor, (torque - model) * factor, motion.dtheta)
    )
    return _Shown(time, measured, modelled, residuals, dtheta, unit, _literal(found.model.name))


def figure(found: Identification) -> Figure:
    """Return the picture: torque and model over time, residuals, the loop, the test of the model, dynamic stiffness.

    A line ends where a recording ends, or a gap begins.
    """
    from matplotlib.figure import Figure

    shown = _shown(found)
    drawn = Figure(figsize=(10, 9), layout="constrained")
    panels = drawn.subplot_mosaic(
        [
            ["torque", "torque", "loop"],
            ["residuals", "residuals", "loop"],
            ["correlation", "plane", "dynamic"],
        ],
        height_ratios=[2, 1, 1.5],
    )
    _draw_traces(shown, panels["torque"], panels["residuals"])
    panels["torque"].set_title(headline(found), pad=24)
    _draw_loop(shown, panels["loop"])
    factor = people_unit("N*m", milli=milli(found))[0]
    draw_correlation(found.lack_of_fit, panels["correlation"])
    draw_plane(found.lack_of_fit, panels["plane"], factor, shown.unit)
    draw_dynamic_stiffness(found.dynamic_stiffness, panels["dynamic"], factor, f"{shown.unit}/rad")
    for name in ("torque", "residuals", "loop", "correlation", "dynamic"):
        panels[name].grid(visible=True, lw=0.3)
    return drawn


def pictures(found: Identification) -> list[Picture]:
    """Return the pictures of a result one by one, each with its numbers in words."""
    shown = _shown(found)
    light = shown.thinned(_SHOWN)
    answer, size = headline(found), f"{float(np.nanmean(np.abs(shown.residuals))):.3g} {shown.unit}"
    low, high = found.signals.band
    drawn = [
        Picture(
            "traces",
            "Torque, measured and modelled",
            f"Torque at the joint over time with the model {found.model.name}; they differ by {size} on average.",
            lambda: _traces(light),
            _chart(shown),
        ),
        Picture(
            "loop",
            "Torque over deflection",
            f"The loop of torque over deflection, measured and modelled: its slope is Kc, its width is friction and "
            f"damping. {answer}.",
            lambda: _loop(shown.strided()),
        ),
        Picture(
            "residuals",
            "Residuals",
            f"Spectrum and autocorrelation of the residuals; 95 % of white noise lies in the shaded bands. The excited "
            f"band is {low:.2g} to {high:.3g} Hz.",
            lambda: _residuals(found),
        ),
        Picture("intervals", "Intervals", _intervals_alt(found), lambda: _intervals(found)),
    ]
    fit, dynamic = found.lack_of_fit, found.dynamic_stiffness
    if fit is not None:
        words = "the model does not describe the recording" if fit.misfit else "no misfit was found"
        text = f"Residuals beside the earlier motion, and over deflection and rate: {words}; the motion predicts "
        alt = f"{text}{fit.share:.1%} of their power."
        drawn.append(Picture("fit", "Does the model describe the recording?", alt, lambda: _lack_of_fit(found)))
    if dynamic is not None:
        bands, factor = dynamic.bands, people_unit("N*m", milli=milli(found))[0]
        least, most = factor * float(bands.stiffness.min()), factor * float(bands.stiffness.max())
        alt = (
            f"Stiffness without a model in {len(bands.frequency)} bands from {bands.frequency[0]:.2g} to "
            f"{bands.frequency[-1]:.3g} Hz: {least:.4g} to {most:.4g} {shown.unit}/rad, with 95 % intervals."
        )
        drawn.append(Picture("dynamic", "Dynamic stiffness", alt, lambda: _dynamic(found)))
    return drawn


def _traces(shown: _Shown) -> Figure:
    drawn, panels = _panels(2, 1, (9, 5), sharex=True, height_ratios=[2, 1])
    _draw_traces(shown, *panels)
    return drawn


def _chart(shown: _Shown) -> Chart | None:
    """The traces to zoom; None for pooled recordings, which share their times."""
    if not (np.diff(shown.time[np.isfinite(shown.time)]) > 0.0).all():
        return None
    light, unit = shown.thinned(_CHARTED), shown.unit
    lines = [Line("measured", light.measured, "soft"), Line("model", light.modelled, "first")]
    panels = [
        Panel(f"torque [{unit}]", lines),
        Panel(f"error [{unit}]", [Line("error", light.residuals, "error")]),
    ]
    return Chart("time [s]", light.time, panels)


def _loop(shown: _Shown) -> Figure:
    drawn, panels = _panels(1, 1, (9, 5))
    _draw_loop(shown, *panels)
    panels[0].legend(loc="upper left")
    return drawn


def _residuals(found: Identification) -> Figure:
    """Their spectrum and autocorrelation, each with the bounds within which 95 % of white noise lies."""
    from matplotlib.mlab import psd  # scipy.signal would cost a second to import
    from scipy.special import gammaincinv

    factor, unit = people_unit("N*m", milli=milli(found))
    values = factor * (found.signals.torque - _modelled(found))
    values -= values.mean()
    rate = 1.0 / float(np.median(np.diff(found.signals.motion.time)))
    segment = min(len(values) // 4, 1024)
    drawn, (spectrum, correlation) = _panels(1, 2, (9, 3.6))
    power, frequency = map(np.asarray, psd(values, segment, rate, detrend="mean", window=np.hanning(segment + 1)[:-1]))
    spectrum.loglog(frequency[1:], power[1:], lw=0.8)
    count = len(values) // segment  # chi-squared with two degrees of freedom a segment
    level = 2.0 * float(values.var()) / rate
    spectrum.axhspan(*(level * gammaincinv(count, (0.025, 0.975)) / count), color="0.5", alpha=0.3, lw=0)
    spectrum.set(xlabel="frequency [Hz]", ylabel=f"power of the residuals [({unit})$^2$/Hz]")
    lags = np.arange(1, min(len(values) // 4, 200))
    padded = np.fft.rfft(values, 2 * len(values))
    alike = np.fft.irfft(np.abs(padded) ** 2)[: len(lags) + 1]
    correlation.plot(lags / rate * 1e3, alike[1:] / alike[0] if alike[0] > 0.0 else 0.0 * lags, lw=0.8)
    bound = 1.96 / np.sqrt(len(values))
    correlation.axhspan(-bound, bound, color="0.5", alpha=0.3, lw=0)
    correlation.set(xlabel="lag [ms]", ylabel="autocorrelation of the residuals")
    return drawn


def _intervals(found: Identification) -> Figure:
    """The 95 % interval of each parameter, in percent of its value."""
    known = _known(found)
    drawn, (panel,) = _panels(1, 1, (9, 0.9 + 0.45 * max(len(known), 1)))
    for at, estimate in enumerate(known):
        low, high = (100.0 * (end / estimate.value - 1.0) for end in estimate.ci95)
        panel.plot(sorted((low, high)), (at, at), "|-", lw=2, ms=12, mew=2, color="C0")
        panel.plot(0.0, at, "o", ms=5, color="C0")
    panel.set_yticks(range(len(known)), [_literal(estimate.name) for estimate in known])
    panel.set(xlabel="95 % interval, % of the value", ylim=(len(known) - 0.5, -0.5))
    return drawn


def _intervals_alt(found: Identification) -> str:
    parts = []
    for estimate in _known(found):
        value, half, _, unit = printed(found, estimate)
        parts.append(f"{estimate.name} {value} ± {half} {unit}")
    return f"95 % intervals: {'; '.join(parts)}." if parts else "No parameter has an interval."


def _known(found: Identification) -> list[Estimate]:
    """The parameters with a finite interval and a value that it can be compared with."""
    return [one for one in found.estimates if np.isfinite(one.ci95).all() and one.value != 0.0]


def _lack_of_fit(found: Identification) -> Figure:
    drawn, (correlation, plane) = _panels(1, 2, (9, 3.6))
    plane.grid(visible=False)
    factor, unit = people_unit("N*m", milli=milli(found))
    draw_correlation(found.lack_of_fit, correlation)
    draw_plane(found.lack_of_fit, plane, factor, unit)
    return drawn


def _dynamic(found: Identification) -> Figure:
    drawn, (panel,) = _panels(1, 1, (9, 4))
    factor, unit = people_unit("N*m", milli=milli(found))
    draw_dynamic_stiffness(found.dynamic_stiffness, panel, factor, f"{unit}/rad")
    return drawn


def recording_figure(channels: Mapping[str, Array], units: Mapping[str, str]) -> Figure:
    """Return the picture of channels (n,), SI: command, torque, deflection over time, and torque over deflection."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(10, 6), layout="constrained")
    panels = drawn.subplot_mosaic([["command", "loop"], ["torque", "loop"], ["dtheta", "loop"]], width_ratios=[2, 1])
    for channel, label in (("command", "command"), ("torque", "torque at the joint"), ("dtheta", "deflection")):
        panels[channel].plot(channels["time"], channels[channel], lw=0.7)
        panels[channel].set(ylabel=f"{label} [{units[channel].replace('*', ' ')}]")
    panels["dtheta"].set(xlabel="time [s]")
    panels["loop"].plot(channels["dtheta"], channels["torque"], lw=0.4)
    panels["loop"].set(xlabel="deflection [rad]", ylabel="torque at the joint [N m]", title="torque over deflection")
    for panel in panels.values():
        panel.grid(visible=True, lw=0.3)
    return drawn


def _panels(rows: int, columns: int, size: tuple[float, float], **layout: Any) -> tuple[Figure, list[Axes]]:
    from matplotlib.figure import Figure

    drawn = Figure(figsize=size, layout="constrained")
    ratios = {"height_ratios": layout.pop("height_ratios")} if "height_ratios" in layout else {}
    panels = list(np.ravel(drawn.subplots(rows, columns, squeeze=False, gridspec_kw=ratios, **layout)))
    for panel in panels:
        panel.grid(visible=True, lw=0.3)
    return drawn, panels


def _draw_traces(shown: _Shown, torque: Axes, residuals: Axes) -> None:
    torque.plot(shown.time, shown.measured, lw=0.8, color="0.65", label="measured")
    torque.plot(shown.time, shown.modelled, lw=0.6, color="C0", label=shown.model)
    torque.set(ylabel=f"torque at the joint [{shown.unit}]")
    torque.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)
    residuals.plot(shown.time, shown.residuals, lw=0.4, color="C3")
    residuals.set(xlabel="time [s]", ylabel=f"error [{shown.unit}]")


def _draw_loop(shown: _Shown, loop: Axes) -> None:
    loop.plot(shown.dtheta, shown.measured, lw=0.6, color="0.65", label="measured")
    loop.plot(shown.dtheta, shown.modelled, lw=0.4, color="C0", label=shown.model)
    loop.set(xlabel="deflection [rad]", ylabel=f"torque at the joint [{shown.unit}]")


def _literal(text: str) -> str:
    """Return the text for a picture, where two $ would begin a formula."""
    return text.replace("$", r"\$")


def write_pictures(drawn: Sequence[Picture], folder: Path, *, force: bool) -> list[Path]:
    """Write each picture as NAME.png into a folder, made where it is missing; return their paths. Raises WrongUse."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{one.name}.png" for one in drawn]
    for path in paths:
        check_output(path, force=force)
    for one, path in zip(drawn, paths, strict=True):
        save_picture(one.draw(), path, force=force)
    return paths


def check_picture_name(path: Path) -> Path:
    """Return the path of a picture. Raises WrongUse for a suffix that says another format."""
    if path.suffix.lower() != ".png":
        raise WrongUse(f"{path} is no name of a picture, which is PNG: name it {path.with_suffix('.png')}")
    return path


def save_picture(figure: Figure, path: Path, *, force: bool) -> None:
    """Write a figure as a PNG. force: in place of one that is there. Raises WrongUse where it cannot be written."""
    with atomic_write(path, force=force) as temporary:
        figure.savefig(temporary, format="png", dpi=110)


def _broken(values: Array, starts: tuple[int, ...]) -> Array:
    """The values with a NaN before each stretch but the first, where a line is interrupted."""
    return np.insert(values, starts[1:], np.nan)


def _modelled(found: Identification) -> Array:
    """The torque of the model, (n,) N m, for the motion of the recordings."""
    signals = found.signals
    values = np.array([estimate.exact for estimate in found.estimates])
    nonlinear = values[len(found.model.linear) :]
    columns = found.model.columns(signals.motion, nonlinear)
    known = signals.torque - found.model.target(signals.motion, signals.torque, nonlinear)
    return np.asarray(known + columns @ values[: len(found.model.linear)])
