"""Pictures of what the model does not explain: the residuals compared with white noise, and the dynamic stiffness
without a model.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.report.chart import Band, Chart, Heat, Line, Panel
from hil.report.formatting import people_unit
from hil.report.identification import milli
from hil.report.pictures.traces import modelled

if TYPE_CHECKING:
    from hil.identification.misfit.dynamic_stiffness import DynamicStiffness
    from hil.identification.misfit.outcome import LackOfFit
    from hil.identification.result import Identification

Array = NDArray[np.float64]

_SEGMENT = 1024  # samples of the residuals in a spectrum, at most
_LAGS = 200


def residuals_chart(found: Identification) -> Chart:
    """Return the residuals' spectrum and autocorrelation, each with the bounds that contain 95 % of white noise."""
    _, unit = people_unit("N*m", milli=milli(found))
    values, rate = _residuals(found)
    lags, alike = _autocorrelation(values)
    bound = _bound(values)
    correlation = Panel(
        "lag [ms]",
        "autocorrelation of the residuals",
        [Line("", lags / rate * 1e3, alike)],
        bands=[Band(-bound, bound, "95 % of white noise")],
    )
    return Chart([spectrum_panel(values, rate, unit), correlation], columns=2)


def residuals_text(found: Identification) -> str:
    """Return the residuals' spectrum and autocorrelation in words."""
    _, unit = people_unit("N*m", milli=milli(found))
    values, rate = _residuals(found)
    lags, alike = _autocorrelation(values)
    largest, bound = int(np.abs(alike).argmax()), _bound(values)
    outside = float((np.abs(alike) > bound).mean())
    low, high = found.signals.band
    return (
        f"Spectrum and autocorrelation of the residuals, {float(values.std()):.3g} {unit} r.m.s.; 95 % of white noise "
        f"lies in the shaded bands. The largest autocorrelation is {alike[largest]:.2g}, at "
        f"{lags[largest] / rate * 1e3:.3g} ms; {outside:.0%} of it is outside its 95 % bounds of ±{bound:.2g}. The "
        f"excited band is {low:.2g} to {high:.3g} Hz."
    )


def _residuals(found: Identification) -> tuple[Array, float]:
    """Return the residuals (n,) in the printed unit, without their mean, and their sampling rate, Hz."""
    factor, _ = people_unit("N*m", milli=milli(found))
    values = factor * (found.signals.torque - modelled(found))
    return values - values.mean(), 1.0 / found.signals.motion.step


def spectrum_panel(values: Array, rate: float, unit: str) -> Panel:
    """Return the power of the residuals over frequency by Welch's method, Hann windows that overlap by half."""
    from scipy.special import gammaincinv

    segment = max(2, min(len(values) // 4, _SEGMENT))
    window = np.hanning(segment + 1)[:-1]
    pieces = np.lib.stride_tricks.sliding_window_view(values, segment)[:: max(1, segment // 2)]
    pieces = pieces - pieces.mean(axis=1, keepdims=True)
    power = 2.0 * np.mean(np.abs(np.fft.rfft(window * pieces)) ** 2, axis=0) / (rate * np.sum(window**2))
    frequency = np.fft.rfftfreq(segment, 1.0 / rate)
    count = len(values) // segment  # chi-squared with two degrees of freedom a segment
    low, high = 2.0 * float(values.var()) / rate * gammaincinv(count, (0.025, 0.975)) / count
    return Panel(
        "frequency [Hz]",
        f"power of the residuals [({unit})²/Hz]",
        [Line("", np.asarray(frequency[1:], np.float64), power[1:])],
        x_scale="log",
        scale="log",
        bands=[Band(low, high, "95 % of white noise")],
    )


def _autocorrelation(values: Array) -> tuple[Array, Array]:
    """Return the lags, in samples, and the autocorrelation at each lag; all zero for values that are zero."""
    lags = np.arange(1.0, max(2, min(len(values) // 4, _LAGS)))
    padded = np.fft.rfft(values, 2 * len(values))
    alike = np.fft.irfft(np.abs(padded) ** 2)[: len(lags) + 1]
    return lags, alike[1:] / alike[0] if alike[0] > 0.0 else 0.0 * lags


def _bound(values: Array) -> float:
    """Return the bound that contains 95 % of the autocorrelation values of white noise."""
    return 1.96 / math.sqrt(len(values))


def lack_of_fit_chart(found: Identification, misfit: LackOfFit) -> Chart:
    """Return the residuals' correlation with the earlier motion, and their mean over deflection and rate."""
    factor, unit = people_unit("N*m", milli=milli(found))
    return Chart([correlation_panel(misfit), plane_panel(misfit, factor, unit)], columns=2)


def correlation_panel(found: LackOfFit) -> Panel:
    """Return the correlation of the residuals with the earlier deflection and rate, and the bound expected by
    chance.
    """
    names = (("deflection", "first"), ("rate", "error"))
    chance = 1.96 / math.sqrt(found.samples)
    lags = found.lags * 1e3
    return Panel(
        "lag [ms]",
        "correlation",
        [Line(name, lags, values, colour) for values, (name, colour) in zip(found.correlation.T, names, strict=True)],
        title=f"residuals with the motion: {'misfit' if found.misfit else 'no misfit'}",
        bands=[Band(-chance, chance)],
    )


def plane_panel(found: LackOfFit, factor: float, unit: str) -> Panel:
    """Return the mean residual over the plane of deflection and rate. factor, unit: from SI to the printed unit of
    torque.
    """
    heat = Heat(factor * found.plane, (0.0, 1.0, 0.0, 1.0), f"mean residual [{unit}]", two_sided=True)
    return Panel("quantile of the rate", "quantile of the deflection", heat=heat)


def dynamic_stiffness_chart(found: Identification, dynamic: DynamicStiffness) -> Chart:
    """Return stiffness K'(f), damping B'(f) and coherence over frequency."""
    factor, unit = people_unit("N*m", milli=milli(found))
    half = factor * np.nan_to_num(dynamic.damping_half_width, posinf=0.0)
    damping = _with_intervals("", dynamic.frequency, factor * dynamic.damping, half, "first")
    coherence = [Line("", dynamic.frequency, dynamic.coherence, "first")]
    return Chart(
        [
            stiffness_panel(dynamic, factor, f"{unit}/rad", "stiffness"),
            Panel("frequency [Hz]", f"B' [{unit} s/rad]", damping, title="damping", x_scale="log"),
            Panel("frequency [Hz]", "coherence", coherence, title="coherence", x_scale="log"),
        ],
        columns=3,
    )


def stiffness_panel(
    found: DynamicStiffness, factor: float, unit: str, title: str = "stiffness without a model"
) -> Panel:
    """Return stiffness K'(f) with its intervals. factor, unit: from SI to the printed unit of stiffness."""
    half = factor * np.nan_to_num(found.stiffness_half_width, posinf=0.0)
    lines = _with_intervals("", found.frequency, factor * found.stiffness, half, "first")
    return Panel("frequency [Hz]", f"K' [{unit}]", lines, title=title, x_scale="log")


def _with_intervals(name: str, x: Array, y: Array, half: Array, colour: str) -> list[Line]:
    """Return a line and its points with intervals of half width `half`."""
    return [Line(name, x, y, colour), Line("", x, y, colour, mark="dot", ends=np.array([y - half, y + half]))]
