"""Find Kc and Bc of the joint alone: the compliance of its fixture, known from an empty-rig recording, is removed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ga.model.separable import SeparableModel
from hil.diagnostics import Diagnostic
from hil.errors import Untrustworthy, WrongUse
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify_sources
from hil.identification.result import Estimate, Fixture, Identification, interval, standard_error, with_scale
from hil.identification.same_stand import same_stand_diagnostics
from hil.identification.series_compliance import Element, Excitation, corrected
from hil.identification.user_model import refuse_without_coupling
from hil.identification.verdict.criteria import narrow
from hil.printable import quoted
from hil.recording.ahead import Progress
from hil.recording.interval import Given
from hil.recording.reader import Recording
from hil.signals.constants import COUPLING, NORMAL
from hil.signals.source import open_sources
from hil.stand.file import load


def identify_without_fixture(
    given: Sequence[Given],
    fixture: Path,
    model: SeparableModel | None,
    search: Search,
    progress: Progress | None = None,
) -> Identification:
    """Fit a model to the recordings of the joint and to the empty-rig recording, and remove the fixture's compliance.

    fixture: the empty-rig recording, or a stand file that names it. Raises as `hil.identification.identify.identify`;
    WrongUse if the empty rig is of another stand or is one of the recordings, and for a model without Kc and Bc;
    Untrustworthy as `without_fixture`.
    """
    refuse_without_coupling(model, "--fixture corrects Kc and Bc", ", or leave the option out")
    with open_sources([*given, empty_rig(fixture)]) as (*sources, rig):
        stands = same_stand_diagnostics([sources[0], rig])
        found = identify_sources(sources, model, search, progress)
        held = identify_sources([rig], model, replace(search, checkpoint=None), progress)
    return without_fixture(replace(found, diagnostics=(*found.diagnostics, *stands)), held)


def empty_rig(path: Path) -> Path:
    """Return the empty-rig recording: the given file, or the one that `hil calibrate fixture` wrote into a stand file.

    Raises WrongUse if the stand file names none, or if that recording has been replaced.
    """
    if path.suffix != ".toml":
        return path
    fixture = load(path).calibration.fixture
    if fixture is None:
        raise WrongUse(
            f"{path} has no [calibration.fixture]: record the empty rig with hil calibrate fixture {quoted(path)}"
        )
    recording = path.parent / fixture.recording
    with Recording(recording) as opened:
        if str(opened.attributes.get("uid", "")) != fixture.uid:
            raise WrongUse(
                f"{recording} is not the recording that [calibration.fixture] of {path} was made from: calibrate again "
                f"with hil calibrate fixture {quoted(path)}"
            )
    return recording


def without_fixture(joint: Identification, fixture: Identification) -> Identification:
    """Return Kc and Bc of the joint alone, with the errors of both recordings in their intervals.

    The diagnostics include those of the empty-rig recording, and an error for each parameter that is no longer
    identifiable. Raises Untrustworthy if the fixture is softer than the joint, or if its recording does not identify
    its stiffness.
    """
    if not fixture["Kc"].identifiable:
        why = next((one.message for one in fixture.diagnostics if one.is_error), "it is as small as its noise")
        raise Untrustworthy(f"{fixture.recordings[0]} does not identify the stiffness of the fixture: {why}")
    signals = joint.signals
    motion = signals.motion
    is_whole = len(joint.recordings) == 1 and len(signals) >= joint.samples
    excitation = Excitation.of(motion.time, motion.dtheta) if is_whole else Excitation.flat(signals.band)
    coupling = corrected(_element(joint), _element(fixture), excitation)
    stiffness, damping = (coupling.stiffness, coupling.stiffness_error), (coupling.damping, coupling.damping_error)
    corrections = {"Kc": stiffness, "Bc": damping}
    # the torque's scale has the same relative error in both, and so in the difference
    scale = joint.torque_scale.included
    estimates = tuple(
        _corrected(estimate, *corrections[estimate.name], scale) if estimate.name in corrections else estimate
        for estimate in joint.estimates
    )
    no_longer_identifiable = [
        _not_separated(after)
        for before, after in zip(joint.estimates, estimates, strict=True)
        if before.identifiable and not after.identifiable
    ]
    return replace(
        joint,
        estimates=estimates,
        diagnostics=(*_without_series_misfit(joint), *_fixture_diagnostics(fixture), *no_longer_identifiable),
        fixture=Fixture(fixture.recordings[0], fixture.model.name, tuple(fixture[name] for name in COUPLING)),
    )


def _without_series_misfit(found: Identification) -> list[Diagnostic]:
    """Return the diagnostics, without a misfit that is explained by the fixture in series with the joint."""
    test = found.lack_of_fit
    series = test is not None and any(one.effect.is_of("branch") for one in test.suspects)
    return [one for one in found.diagnostics if not (series and one.code == "misfit")]


def _fixture_diagnostics(fixture: Identification) -> list[Diagnostic]:
    """Return the diagnostics of the fixture. A damping that is not identifiable is no error, because the intervals
    include it.
    """
    return [
        Diagnostic(
            one.code,
            f"{fixture.recordings[0]}, the fixture: {one.message}",
            one.parameter,
            is_error=one.is_error and (one.code, one.parameter) != ("not-identifiable", "Bc"),
        )
        for one in fixture.diagnostics
    ]


def _not_separated(estimate: Estimate) -> Diagnostic:
    """Return the error that the interval of Kc or Bc is too wide after the fixture is subtracted."""
    return Diagnostic(
        "not-identifiable",
        f"{estimate.name} of the joint cannot be separated from that of the fixture: its interval after the "
        "correction is too wide. Stiffen the fixture, or record both for longer and over a wider band",
        estimate.name,
        is_error=True,
    )


def _element(found: Identification) -> Element:
    kc, bc = found["Kc"], found["Bc"]
    return Element(kc.value, bc.value, standard_error(kc), standard_error(bc))


def _corrected(estimate: Estimate, value: float, error: float, common: float) -> Estimate:
    shift, half = value - estimate.value, NORMAL * error
    trials = estimate.optimiser
    alone = replace(
        estimate,
        value=value,
        ci95=interval(value, half, positive=estimate.positive),
        conditional=None,
        optimiser=replace(trials, best=trials.best + shift, mean=trials.mean + shift),
        identifiable=estimate.identifiable and narrow(half, value),
        widths={"joint and fixture": half},
    )
    return with_scale(alone, common)
