"""Identify Kc and Bc from recordings: signals, model, genetic search, exact optimum, confidence intervals,
diagnostics.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import ThreadpoolController

from ga.arrays import Array
from ga.model.coupling import CouplingModel
from ga.model.record import Parameter, positive_among
from ga.model.separable import SeparableModel
from ga.model.terms import size_of
from hil.diagnostics import Diagnostic
from hil.identification.candidates.choice import Choice, choose
from hil.identification.deflection.correction import DeflectionErrors, read_with_errors
from hil.identification.deflection.held import most_taken_off
from hil.identification.deflection.instruments import is_instrument
from hil.identification.fitting.confidence import confidence_intervals
from hil.identification.fitting.dataset import Dataset, open_dataset
from hil.identification.fitting.solution import Search, Solution, solve, without_signs
from hil.identification.fitting.unloaded import rest_for
from hil.identification.fitting.validation import validated
from hil.identification.misfit.described import Described, tested
from hil.identification.mixture.average import averaged
from hil.identification.mixture.width import Width, beyond, combined
from hil.identification.result import Estimate, Identification, Step, with_scale
from hil.identification.same_stand import calibration_diagnostics, other_joints_diagnostics, same_stand_diagnostics
from hil.identification.verdict.deflection import (
    deflection_diagnostics,
    ignored_command,
    summarised,
)
from hil.identification.verdict.evidence import Evidence, estimates, span_met, with_misfit
from hil.identification.verdict.identifiability import judge, uncertain_scale, wide_intervals
from hil.identification.verdict.misfit import lost_by_misfit, misfit_diagnostics
from hil.identification.verdict.stationarity import disagreement, other_zeros, pooled_intervals
from hil.recording.ahead import Progress
from hil.recording.channels import TorqueScale
from hil.recording.interval import Given
from hil.signals import constants as c
from hil.signals.prepare import Signals
from hil.signals.source import Source, open_sources

_UNMOVED = ("deflection-noise", "poor-snr")  # errors of a recording without usable motion


def identify(
    given: Sequence[Given], model: SeparableModel | None, search: Search, progress: Progress | None = None
) -> Identification:
    """Fit a model to the pooled recordings. model: None for the model that model selection chooses.

    Ctrl-C during the search ends only the search: the result so far is returned, with its trials marked as interrupted.
    Raises WrongUse, and Untrustworthy if the recordings cannot be used at all; lesser doubts are in the diagnostics.
    """
    with open_sources(given) as sources:
        return identify_sources(sources, model, search, progress)


def identify_sources(
    sources: Sequence[Source], model: SeparableModel | None, search: Search, progress: Progress | None = None
) -> Identification:
    """Fit a model to open recordings on one core: with several cores the last digit would differ."""
    with ThreadpoolController().limit(limits=1, user_api="blas"):
        return _identified(sources, model, search, progress)


def _identified(
    sources: Sequence[Source], model: SeparableModel | None, search: Search, progress: Progress | None
) -> Identification:
    began = time.perf_counter()
    stands = [*same_stand_diagnostics(sources), *calibration_diagnostics(sources), *other_joints_diagnostics(sources)]
    scale = TorqueScale.widest(source.torque_scale for source in sources)

    def chosen(signals: Signals, whole: bool) -> Choice:
        if progress is not None and model is None:
            progress("choosing the model", 0.0)
        return choose(model, signals, linear_only=not whole or search.preset == "paper")

    with open_dataset(sources, chosen, progress, rest=rest_for(model)) as data:
        solution = solve(data, search, progress)
        found = estimates(evidence := _evidence(data, solution))
        scattered = (evidence.names, evidence.scattered, [source.path for source in sources])
        described = _fit_to_test(data, solution, evidence, differ=bool(differing := disagreement(*scattered)))
        fit, dynamic = tested(described), described.dynamic_stiffness(data.signals.coupling_torque)
        found = with_misfit(modelled := found, fit)
        doubts: list[Diagnostic] = []
        if not any(one.code == "implausible" for one in data.diagnostics):  # a wrong sign is the cause of all others
            doubts = [
                *differing,
                *other_zeros(*scattered, solution.optimum.fitness),
                *judge(evidence),
                *(deflection_diagnostics(evidence) or ignored_command(data.signals, dynamic)),
                *misfit_diagnostics(described, data.choice.model.name, fit, dynamic, selected=evidence.selected),
                *lost_by_misfit(modelled, found),
            ]
            doubts += [*wide_intervals(evidence, doubts), *uncertain_scale(scale)]
        return Identification(
            recordings=tuple(source.path for source in sources),
            windows=tuple(source.recording.window for source in sources),
            model=data.choice.model,
            steps=_with_result(data.choice.steps, found, solution),
            preset=search.preset,
            seed=search.seed,
            estimates=tuple(
                with_scale(one, scale.included * of.scales) for one, of in zip(found, evidence.parameters, strict=True)
            ),
            fitness=float(solution.trials.fitness.min()),
            optimum=solution.optimum.fitness,
            optimiser_gap=solution.gap,
            samples=data.samples,
            trials=solution.trials,
            seconds=time.perf_counter() - began,
            search_seconds=solution.seconds,
            validation=evidence.holdout,
            diagnostics=tuple(stands + data.diagnostics + doubts),
            signals=data.signals,
            values=solution.values,
            fitted=data.used,
            torque_scale=scale,
            lack_of_fit=fit,
            dynamic_stiffness=dynamic,
            deflection=summarised(evidence),
            reference=data.place.reference,
        )


def _evidence(data: Dataset, solution: Solution) -> Evidence:
    """Return the facts that the result's identifiability is derived from: intervals, validation and optimiser gap."""
    parameters = (*data.choice.model.linear, *data.choice.model.nonlinear)
    sampling = confidence_intervals(solution.blocks, solution.values)
    pooled, components = pooled_intervals(solution.blocks, data.edges, sampling)
    model, used = data.choice.model, data.used
    deflection = read_with_errors(model, data.signals, used, solution.values, sampling.half_width)
    values, chosen = _averaged(data, solution, sampling.half_width, deflection)
    # the interval that is reported may be narrower than that of the selected model
    given = (_names(parameters), solution.values, np.minimum(sampling.half_width, chosen))
    fitted, motion = dict(zip(given[0], solution.values.tolist(), strict=True)), data.signals.motion
    span = data.place.span(fitted, model.terms if isinstance(model, CouplingModel) else ())
    if data.choice.steps:
        span = span_met(motion, *given) or data.place.beside_turn(fitted, float(np.ptp(motion.dtheta))) or span
    reach = np.zeros_like(chosen)
    if span is not None:
        values[0] += 0.5 * (span[0] + span[1]) - solution.values[0]  # Kc
        reach[0] = 0.5 * (span[1] - span[0])
    values = np.where([one.positive for one in parameters], np.maximum(values, 0.0), values)
    # held set-points make the rate, and so Bc, wrong by anything up to `taken_off`
    taken_off = most_taken_off(data.signals) or _most_without_command(data.signals, size_of(fitted, "delay"))
    rate = c.NORMAL * np.hypot(c.RATE_ACCURACY, taken_off / 3.0**0.5) * np.abs(solution.values)
    rate[[name != "Bc" for name in given[0]]] = 0.0
    noise = np.minimum(sampling.half_width, chosen)
    others = [
        Width("differences between recordings", beyond(pooled.half_width, sampling.half_width)),
        Width("errors of the deflection", deflection.half_width if deflection else np.zeros_like(noise)),
        Width("errors of the rate", rate),
    ]
    choice = [Width("noise", noise), Width("choice of the model", beyond(chosen, noise))]
    widths = [*choice, *others, Width("range of Kc", reach, is_range=True)]
    return Evidence(
        model=data.choice.model,
        signals=data.signals,
        reference=data.place.reference,
        solution=solution,
        values=values,
        errors=replace(pooled, half_width=combined(widths)),
        widths=tuple(widths),
        exact=(solution.values, combined([Width("noise", sampling.half_width), *others])),
        scattered=components,
        unbounded=without_signs(solution.blocks, solution.values, positive_among(parameters)),
        holdout=validated(data, solution.blocks, solution.values, np.isfinite(sampling.half_width)),
        selected=bool(data.choice.steps),
        span=span,
        deflection=deflection,
        unmoved=next((one.message for one in data.diagnostics if one.is_error and one.code in _UNMOVED), ""),
    )


def _most_without_command(signals: Signals, delay: float) -> float:
    """Return the largest part of Bc that held set-points may take off if few readings in a period and no command are
    recorded: then nothing shows how fast the drive follows.

    A drive of natural frequency w (rad/s) and damping ratio z takes off h^2/12 w^2 of Bc, with the time step h, and
    looks like a delay of z w h^2/6. delay: that of the fitted model, s. The motor's torque is itself held, so that half
    a tick of delay changes the whole of Bc.
    """
    step = float(np.median(np.diff(signals.motion.time)))
    is_dense = 1.0 / step > c.DENSE_READINGS * signals.band[1]
    if signals.window is None or signals.motion.part_of is not None or is_dense or is_instrument(signals.command):
        return 0.0
    if signals.torque_from == "motor":
        return 1.0
    return float(np.clip(3.0 * (delay / (c.DRIVE_DAMPING * step)) ** 2, c.TAKEN_OFF, 1.0))


def _averaged(
    data: Dataset, solution: Solution, half_width: Array, deflection: DeflectionErrors | None
) -> tuple[Array, Array]:
    """Return the values (p + q,) and half intervals, with Kc and Bc averaged over models if one was selected.

    Each model is corrected separately for errors of the deflection: they change a larger model more.
    """
    half_width = half_width.copy()
    names = _names((*data.choice.model.linear, *data.choice.model.nonlinear))
    nonlinear = solution.values[len(data.choice.model.linear) :]
    change = deflection.change if deflection else np.zeros(len(names))
    values = solution.values + change
    own = dict(zip(names, change.tolist(), strict=True))
    for name, one in (averaged(data.choice, data.signals, data.used, nonlinear, own) if data.whole else {}).items():
        at = names.index(name)
        values[at], half_width[at] = one.value, one.half_width
    return values, half_width


def _fit_to_test(data: Dataset, solution: Solution, evidence: Evidence, *, differ: bool) -> Described:
    """Return the signals and the fitted model, SI, for the lack-of-fit tests. differ: whether Kc or Bc differs between
    pooled recordings.
    """
    _, target = next(iter(solution.blocks())) if data.choice.model.nonlinear else data.in_memory
    return Described(
        model=data.choice.model,
        signals=data.signals,
        kept=data.used,
        residuals=target - solution.columns @ solution.values,
        columns=solution.columns,
        values=solution.values,
        half_width=evidence.errors.half_width + np.abs(evidence.values - solution.values),
        averaged=bool(data.choice.steps),
        ends_if_differing=data.edges if differ and data.whole else (),
    )


def _with_result(steps: Sequence[Step], found: Sequence[Estimate], solution: Solution) -> tuple[Step, ...]:
    """Return the steps of model selection, with the final values in the last included step.

    Model selection also uses samples in which the joint may stick, and only a part of a recording that does not fit in
    memory, so its own values differ in the last digits.
    """
    if not steps:
        return ()
    last = max(at for at, step in enumerate(steps) if step.included)
    final = replace(steps[last], fitness=solution.optimum.fitness, Kc=found[0].exact, Bc=found[1].exact)
    return (*steps[:last], final, *steps[last + 1 :])


def _names(parameters: tuple[Parameter, ...]) -> tuple[str, ...]:
    return tuple(parameter.name for parameter in parameters)
