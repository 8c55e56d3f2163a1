"""Figures of what the model does not explain: the residuals compared with white noise, and the dynamic stiffness
without a model.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.report.formatting import people_unit
from hil.report.identification import milli
from hil.report.pictures.canvas import canvas, plain_ticks
from hil.report.pictures.traces import modelled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hil.identification.result import Identification
    from hil.uncertainty.dynamic_stiffness import DynamicStiffness
    from hil.uncertainty.misfit import LackOfFit

Array = NDArray[np.float64]

_SEGMENT = 1024  # samples of the residuals in a spectrum, at most
_LAGS = 200


def residuals_drawn(found: Identification) -> Figure:
    """Return a figure of the residuals' spectrum and autocorrelation, each with the bounds that contain 95 % of white
    noise.
    """
    _, unit = people_unit("N*m", milli=milli(found))
    values, rate = _residuals(found)
    drawn, (spectrum, correlation) = canvas(1, 2, (9, 3.6))
    _draw_spectrum(values, rate, spectrum)
    spectrum.set(xlabel="frequency [Hz]", ylabel=f"power of the residuals [({unit})²/Hz]")
    _draw_autocorrelation(values, rate, correlation)
    plain_ticks(spectrum)
    return drawn


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
    return values - values.mean(), 1.0 / float(np.median(np.diff(found.signals.motion.time)))


def _draw_spectrum(values: Array, rate: float, panel: Axes) -> None:
    from matplotlib.mlab import psd  # scipy.signal would cost a second to import
    from scipy.special import gammaincinv

    segment = min(len(values) // 4, _SEGMENT)
    power, frequency = map(np.asarray, psd(values, segment, rate, detrend="mean", window=np.hanning(segment + 1)[:-1]))
    panel.loglog(frequency[1:], power[1:], lw=0.8)
    count = len(values) // segment  # chi-squared with two degrees of freedom a segment
    level = 2.0 * float(values.var()) / rate
    panel.axhspan(*(level * gammaincinv(count, (0.025, 0.975)) / count), color="0.5", alpha=0.3, lw=0)


def _draw_autocorrelation(values: Array, rate: float, panel: Axes) -> None:
    lags, alike = _autocorrelation(values)
    panel.plot(lags / rate * 1e3, alike, lw=0.8)
    bound = _bound(values)
    panel.axhspan(-bound, bound, color="0.5", alpha=0.3, lw=0)
    panel.set(xlabel="lag [ms]", ylabel="autocorrelation of the residuals")


def _autocorrelation(values: Array) -> tuple[Array, Array]:
    """Return the lags, in samples, and the autocorrelation at each lag; all zero for values that are zero."""
    lags = np.arange(1.0, max(2, min(len(values) // 4, _LAGS)))
    padded = np.fft.rfft(values, 2 * len(values))
    alike = np.fft.irfft(np.abs(padded) ** 2)[: len(lags) + 1]
    return lags, alike[1:] / alike[0] if alike[0] > 0.0 else 0.0 * lags


def _bound(values: Array) -> float:
    """Return the bound that contains 95 % of the autocorrelation values of white noise."""
    return 1.96 / math.sqrt(len(values))


def lack_of_fit_drawn(found: Identification) -> Figure:
    """Return a figure of the residuals: their correlation with the earlier motion, and their mean over deflection and
    rate.
    """
    drawn, (correlation, plane) = canvas(1, 2, (9, 3.6))
    plane.grid(visible=False)
    factor, unit = people_unit("N*m", milli=milli(found))
    draw_correlation(found.lack_of_fit, correlation)
    draw_plane(found.lack_of_fit, plane, factor, unit)
    return drawn


def draw_correlation(found: LackOfFit | None, panel: Axes) -> None:
    """Draw the correlation of the residuals with the earlier deflection and rate, and the bound expected by chance."""
    if found is None:
        panel.set_axis_off()
        return
    for values, name in zip(found.correlation.T, ("deflection", "rate"), strict=True):
        panel.plot(found.lags * 1e3, values, lw=0.8, label=name)
    chance = 1.96 / math.sqrt(found.samples)
    panel.axhspan(-chance, chance, color="0.5", alpha=0.3, lw=0)
    panel.set(xlabel="lag [ms]", title=f"residuals with the motion: {'misfit' if found.misfit else 'no misfit'}")
    panel.legend()


def draw_plane(found: LackOfFit | None, panel: Axes, factor: float, unit: str) -> None:
    """Draw the mean residual over the plane of deflection and rate. factor, unit: from SI to the printed unit of
    torque.
    """
    if found is None:
        panel.set_axis_off()
        return
    values = factor * found.plane
    limit = float(np.nanmax(np.abs(values))) or 1.0
    image = panel.imshow(values, origin="lower", cmap="RdBu", vmin=-limit, vmax=limit, extent=(0, 1, 0, 1))
    panel.figure.colorbar(image, ax=panel, label=f"mean residual [{unit}]")
    panel.set(xlabel="quantile of the rate", ylabel="quantile of the deflection")


def dynamic_stiffness_drawn(found: Identification) -> Figure:
    """Return a figure of stiffness K'(f), damping B'(f) and coherence over frequency."""
    drawn, panels = canvas(1, 3, (9, 3.6))
    factor, unit = people_unit("N*m", milli=milli(found))
    draw_stiffness(found.dynamic_stiffness, panels[0], factor, f"{unit}/rad")
    dynamic = found.dynamic_stiffness
    if dynamic is None:
        return drawn
    for name, bands in dynamic.groups:
        half = factor * np.nan_to_num(bands.damping_half_width, posinf=0.0)
        panels[1].errorbar(bands.frequency, factor * bands.damping, half, fmt=".-", lw=0.8, capsize=2, label=name)
        panels[2].plot(bands.frequency, bands.coherence, ".-", lw=0.8)
    panels[1].set(xscale="log", xlabel="frequency [Hz]", ylabel=f"B' [{unit} s/rad]", title="damping")
    panels[2].set(xscale="log", xlabel="frequency [Hz]", ylim=(None, 1.0), title="coherence")
    panels[0].set(title="stiffness")
    plain_ticks(*panels)
    return drawn


def draw_stiffness(found: DynamicStiffness | None, panel: Axes, factor: float, unit: str) -> None:
    """Draw stiffness K'(f) with its intervals. factor, unit: from SI to the printed unit of stiffness."""
    if found is None:
        panel.set_axis_off()
        return
    for name, bands in found.groups:
        half = factor * np.nan_to_num(bands.stiffness_half_width, posinf=0.0)
        panel.errorbar(bands.frequency, factor * bands.stiffness, half, fmt=".-", lw=0.8, capsize=2, label=name)
    panel.set(xscale="log", xlabel="frequency [Hz]", ylabel=f"K' [{unit}]", title="stiffness without a model")
    if found.by_amplitude:
        panel.legend(title="deflection")
