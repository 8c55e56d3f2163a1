"""The lack-of-fit test and the dynamic stiffness as text, tables and JSON. Nothing is printed here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.report.formatting import engineering, json_number, plain_table, rounded

if TYPE_CHECKING:
    from rich.table import Table

    from hil.uncertainty.dynamic_stiffness import Bands, DynamicStiffness
    from hil.uncertainty.misfit import LackOfFit


def lack_of_fit_json(found: LackOfFit | None) -> dict[str, Any] | None:
    """Return the entry "lack_of_fit" of the JSON object; sizes are relative to Kc and Bc. None if nothing was
    tested.
    """
    if found is None:
        return None
    return {
        "misfit": found.misfit,
        "outside_interval": bool(found.outside),
        "predicted_share": found.share,
        "Kc": found.Kc,
        "Bc": found.Bc,
        "at_jumps": found.at_jumps and {"frequency": found.at_jumps.frequency, "part": found.at_jumps.part},
        "samples": found.samples,
        "tests": [
            {"code": one.code, "name": one.name, "p": one.p, "Kc": one.Kc, "Bc": one.Bc} for one in found.respects
        ],
        "effects": [
            {"code": one.effect.code, "name": one.effect.name, "share": one.share, "Kc": one.Kc, "Bc": one.Bc}
            | {"advice": one.effect.remedy()}
            for one in found.suspects
        ],
    }


def lack_of_fit_line(found: LackOfFit) -> str:
    """Return in words whether the model describes the recording, and which part of the residuals follows from the
    motion.
    """
    result = "found no relevant misfit of the model"
    if found.misfit:
        result = "found a misfit: the model does not describe the recording"
    elif found.is_undecided:
        result = "cannot decide, because the recording is too short"
    return f"the lack-of-fit tests {result}; the motion predicts {found.share:.1%} of the residuals' power"


def dynamic_stiffness_json(found: DynamicStiffness | None) -> dict[str, Any] | None:
    """Return the entry "dynamic_stiffness" of the JSON object, SI units; None if the recording is too short."""
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
    """Return a table of stiffness K'(f) and damping B'(f) with half of their 95 % intervals.

    factor: from SI to the printed units. stiffness, damping: the printed units. If the amplitudes differ, further rows
    are for the half of the segments with the smaller deflection and the half with the larger deflection.
    """
    rows = [row for name, bands in found.groups for row in _band_rows(name, bands, factor)]
    headings = ["f, Hz", f"K', {stiffness}", f"B', {damping}", "coherence", "deflection, r.m.s."]
    if not found.by_amplitude:
        rows, headings = [row[:-1] for row in rows], headings[:-1]
    return plain_table(f"dynamic stiffness, instrument: {found.instrument}", headings, rows)


def _band_rows(name: str, bands: Bands, factor: float) -> list[tuple[str, ...]]:
    rows = []
    for at, frequency in enumerate(bands.frequency.tolist()):
        known = (
            (factor * float(values[at]), factor * float(half[at]))
            for values, half in (
                (bands.stiffness, bands.stiffness_half_width),
                (bands.damping, bands.damping_half_width),
            )
        )
        cells = (" ± ".join(rounded(half, value)) for value, half in known)
        group = f"{name}, {engineering(bands.deflection, 'rad')}"
        rows.append((f"{frequency:.3g}", *cells, f"{bands.coherence[at]:.4f}", group))
    return rows


def distortion_lines(found: DynamicStiffness | None) -> list[str]:
    """Return a line about the harmonic distortion; an empty list if it was not measured."""
    if found is None or found.distortion is None:
        return []
    level, noise, period = found.distortion.level, found.distortion.noise, found.distortion.period
    return [f"distortion {level:.2%} of the torque, noise {noise:.2%}; the excitation repeats every {period:.3g} s"]
