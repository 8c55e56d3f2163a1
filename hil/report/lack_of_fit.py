"""The lack-of-fit test and the dynamic stiffness as people and machines read them. Nothing here prints."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.report.formatting import json_number, plain_table, rounded

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.table import Table

    from hil.uncertainty.dynamic_stiffness import Bands, DynamicStiffness
    from hil.uncertainty.lack_of_fit import LackOfFit


def lack_of_fit_json(found: LackOfFit | None) -> dict[str, Any] | None:
    """Return the object "lack_of_fit" of the JSON; sizes are relative to Kc and Bc. None where nothing was tested."""
    if found is None:
        return None
    return {
        "misfit": found.misfit,
        "outside_interval": found.outside,
        "predicted_share": found.share,
        "Kc": found.Kc,
        "Bc": found.Bc,
        "samples": found.samples,
        "tests": [
            {"code": one.code, "name": one.name, "p": one.p, "Kc": one.Kc, "Bc": one.Bc} for one in found.respects
        ],
        "effects": [
            {"code": one.effect.code, "name": one.effect.name, "share": one.share, "Kc": one.Kc, "Bc": one.Bc}
            | {"advice": one.effect.advice}
            for one in found.suspects
        ],
    }


def dynamic_stiffness_json(found: DynamicStiffness | None) -> dict[str, Any] | None:
    """Return the object "dynamic_stiffness" of the JSON, SI units; None where the recording is too short."""
    if found is None:
        return None
    distortion = found.distortion
    return {
        "instrument": found.instrument,
        **_bands_json(found.bands),
        "by_amplitude": [_bands_json(bands) for bands in found.by_amplitude],
        "distortion": None
        if distortion is None
        else {"level": distortion.level, "noise": distortion.noise, "period": distortion.period},
    }


def _bands_json(bands: Bands) -> dict[str, Any]:
    return {
        "deflection_rms": bands.deflection,
        "frequency": bands.frequency.tolist(),
        "stiffness": bands.stiffness.tolist(),
        "stiffness_half_width": [json_number(value) for value in bands.stiffness_half_width.tolist()],
        "damping": bands.damping.tolist(),
        "damping_half_width": [json_number(value) for value in bands.damping_half_width.tolist()],
        "coherence": bands.coherence.tolist(),
    }


def dynamic_stiffness_table(found: DynamicStiffness, factor: float, stiffness: str, damping: str) -> Table:
    """Return the table of K'(f) and B'(f) with half their 95 % intervals; factor: to the printed units."""
    bands, rows = found.bands, []
    for at, frequency in enumerate(bands.frequency.tolist()):
        known = (
            (factor * float(values[at]), factor * float(half[at]))
            for values, half in (
                (bands.stiffness, bands.stiffness_half_width),
                (bands.damping, bands.damping_half_width),
            )
        )
        cells = (" ± ".join(rounded(half, value)) for value, half in known)
        rows.append((f"{frequency:.3g}", *cells, f"{bands.coherence[at]:.4f}"))
    headings = ("f, Hz", f"K', {stiffness}", f"B', {damping}", "coherence")
    return plain_table(f"dynamic stiffness, instrument: {found.instrument}", headings, rows)


def distortion_lines(found: DynamicStiffness) -> list[str]:
    """Return the line about the distortion; none where the excitation is not periodic."""
    if found.distortion is None:
        return []
    level, noise, period = found.distortion.level, found.distortion.noise, found.distortion.period
    return [f"distortion {level:.2%} of the torque, noise {noise:.2%}; the excitation repeats every {period:.3g} s"]


def draw_dynamic_stiffness(found: DynamicStiffness | None, stiffness: Axes, factor: float, unit: str) -> None:
    """Draw K'(f) with its intervals; factor and unit: in which people read a stiffness."""
    if found is None:
        stiffness.set_axis_off()
        return
    groups = (("all", found.bands), *zip(("small", "large"), found.by_amplitude, strict=False))
    for name, bands in groups:
        half = factor * np.nan_to_num(bands.stiffness_half_width, posinf=0.0)
        stiffness.errorbar(bands.frequency, factor * bands.stiffness, half, fmt=".-", lw=0.8, capsize=2, label=name)
    stiffness.set(xscale="log", xlabel="frequency [Hz]", ylabel=f"K' [{unit}]", title="stiffness without a model")
    if found.by_amplitude:
        stiffness.legend(title="deflection")


def draw_correlation(found: LackOfFit | None, panel: Axes) -> None:
    """Draw the correlation of the residuals with the earlier deflection and rate, and the chance of it."""
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
    """Draw the mean residual over the plane of deflection and rate; factor and unit: in which people read a torque."""
    if found is None:
        panel.set_axis_off()
        return
    values = factor * found.plane
    limit = float(np.nanmax(np.abs(values))) or 1.0
    image = panel.imshow(values, origin="lower", cmap="RdBu", vmin=-limit, vmax=limit, extent=(0, 1, 0, 1))
    panel.figure.colorbar(image, ax=panel, label=f"mean residual [{unit}]")
    panel.set(xlabel="quantile of the rate", ylabel="quantile of the deflection")
