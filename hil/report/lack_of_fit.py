"""The lack-of-fit test and the dynamic stiffness as text, tables and JSON. Nothing is printed here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.report.formatting import Section, json_number, rounded

if TYPE_CHECKING:
    from hil.identification.misfit.dynamic_stiffness import DynamicStiffness
    from hil.identification.misfit.outcome import LackOfFit


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
    return {
        "instrument": found.instrument,
        "deflection_rms": found.deflection,
        "frequency": found.frequency.tolist(),
        "stiffness": found.stiffness.tolist(),
        "stiffness_half_width": [json_number(value) for value in found.stiffness_half_width.tolist()],
        "damping": found.damping.tolist(),
        "damping_half_width": [json_number(value) for value in found.damping_half_width.tolist()],
        "coherence": found.coherence.tolist(),
    }


def dynamic_stiffness_section(found: DynamicStiffness, factor: float, stiffness: str, damping: str) -> Section:
    """Return a table of stiffness K'(f) and damping B'(f) with half of their 95 % intervals.

    factor: from SI to the printed units. stiffness, damping: the printed units.
    """
    known = [(found.stiffness, found.stiffness_half_width), (found.damping, found.damping_half_width)]
    columns = [
        [" ± ".join(rounded(factor * error, factor * value)) for value, error in zip(*pair, strict=True)]
        for pair in known
    ]
    frequency = [f"{value:.3g}" for value in found.frequency.tolist()]
    coherence = [f"{value:.4f}" for value in found.coherence.tolist()]
    headings = ["f, Hz", f"K', {stiffness}", f"B', {damping}", "coherence"]
    rows = zip(frequency, *columns, coherence, strict=True)
    return Section(f"dynamic stiffness, instrument: {found.instrument}", [headings, *rows])
