"""Predict the error of each parameter from a motion and from the sensors (Fisher information).

Two errors are predicted. The Cramer-Rao bound is the smallest error of any unbiased estimate; least squares reaches
this bound in Gaussian noise. `hil identify` minimises absolute deviations, as the paper does, which in white Gaussian
noise increases the error by a factor sqrt(pi/2) = 1.25 (Koenker, Quantile Regression, 2005, section 4.3).

Both errors follow from the derivatives x of the torque with respect to each parameter, and from the spectrum of the
residuals. With the correct model the residuals are the noise of the torque and the noise of the angle, which the
coupling converts to torque.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.model.coupling import CouplingModel, parse
from ga.model.effects.friction import COULOMB
from ga.model.terms import TERMS as TABLE
from ga.model.trajectory import Motion
from hil.experiment_design.response import Joint, Response
from hil.identification.fitting.confidence import inverse
from hil.signals.rate.savitzky_golay import kernel
from hil.signals.rate.spectrum import excited_band
from hil.signals.rate.windows import hides_in_rate, narrowed, windows

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]

_SMOOTHING = 0.05  # of the Coulomb term, as a part of the r.m.s. rate
_REPEATS = 30  # of a reweighted fit, after which nothing moves


@dataclass(frozen=True, slots=True)
class Readings:
    """The errors of the stand's sensors, all at the joint.

    torque_noise: standard deviation of the white Gaussian torque noise, N m. torque_lsb: one count of the torque, N m.
    angle_lsb: one count of the deflection, rad; for several encoders the root of the sum of squares. skew: how much
    older the torque reading is than the angle reading, s. motor_side: whether the torque is computed from the motor's
    torque through equation (1).
    """

    torque_noise: float
    torque_lsb: float
    angle_lsb: float
    skew: float
    motor_side: bool

    @property
    def white(self) -> float:
        """The standard deviation of the torque reading, N m: noise and rounding to counts together."""
        return math.hypot(self.torque_noise, self.torque_lsb / math.sqrt(12.0))


@dataclass(frozen=True, slots=True)
class Prediction:
    """The predicted error of one parameter, SI.

    rough: the parameter's assumed value. error: standard error of the estimate of `hil identify` (least absolute
    deviations). bound: Cramer-Rao bound of the standard error. bias: systematic error from the known skew of the
    readings and from the smoothing of the rate. inflation: variance of the parameter, divided by the variance if all
    other parameters were known. These numbers are infinite if the parameter cannot be estimated.
    """

    name: str
    unit: str
    rough: float
    error: float
    bound: float
    bias: float
    inflation: float

    def relative(self, scatter: float = 1.0) -> float:
        """Return the root mean square error (bias and standard error together), relative to the rough value of the
        parameter.

        scatter: a factor on the standard error.
        """
        return math.hypot(scatter * self.error, self.bias) / self.rough


TERMS = tuple(name for name, term in TABLE.items() if term.linear or term.delays)
"""The names of the terms whose errors can be predicted. For other terms the torque has no derivative where the term is
zero.
"""


def sensitivities(terms: tuple[str, ...], joint: Joint, motion: Response) -> Array:
    """Return the derivative of the torque (n, p + q) with respect to each parameter of the terms; the nonlinear
    parameters are last.

    The derivative is taken at the rough Kc and Bc, with all other parameters zero.
    """
    speed = _SMOOTHING * float(np.sqrt(np.mean(motion.dtheta_dot**2)))
    model = replace(_model(terms), origin=float(motion.time[0]), slowest=0.0, smoothing=speed)
    still = np.zeros_like(motion.time)
    moving = Motion(motion.time, motion.dtheta, motion.dtheta_dot, motion.acceleration, still)
    changing = Motion(motion.time, motion.dtheta_dot, motion.acceleration, still, still)
    absent = np.zeros(len(model.nonlinear))
    genes = np.array([joint.stiffness, joint.damping, *np.zeros(len(model.linear) - 2)])
    columns = (model.columns(moving, absent), model.jacobian(moving, absent, genes, changing=changing))
    return np.concatenate(columns, axis=1)


def _model(terms: tuple[str, ...]) -> CouplingModel:
    return parse("+".join(terms))


def predict(terms: tuple[str, ...], joint: Joint, motion: Response, readings: Readings) -> tuple[Prediction, ...]:
    """Return the predicted error of each parameter of the terms, for this motion and these sensors."""
    columns = sensitivities(terms, joint, motion)
    gram = columns.T @ columns
    variance, estimable = inverse(gram)
    rough = _rough(terms, joint, readings)
    bound, error, bias, inflation = (np.full(len(estimable), np.inf) for _ in range(4))
    if estimable.any():
        kept = columns[:, estimable]
        filters = _filters(motion, readings.angle_lsb)
        bound[estimable] = np.sqrt(np.diag(_bound(kept, joint, readings, filters.step)))
        filtered, residual = _filtered(joint, motion, readings, filters), _residual(len(kept), joint, readings, filters)
        fitted, misfit = _misfit(sensitivities(terms, joint, filtered)[:, estimable], filtered.torque, residual)
        bias[estimable] = fitted - rough[estimable]
        error[estimable] = np.sqrt(np.diag(_absolute(kept, misfit, residual)))
        inflation[estimable] = np.diag(variance * gram)[estimable]
    numbers = np.stack([rough, error, bound, bias, inflation], axis=1).tolist()
    return tuple(
        Prediction(parameter.name, parameter.unit, *row)
        for parameter, row in zip(_model(terms).parameters, numbers, strict=True)
    )


def mistaken_friction(terms: tuple[str, ...], joint: Joint, motion: Response) -> float:
    """Return the error of Bc, N m s/rad, for each N m of dry friction that the model omits; 0 if the model has
    friction.
    """
    if _model(terms).sticks:
        return 0.0
    columns = sensitivities(terms, joint, motion)
    friction = sensitivities(("linear", COULOMB.name), joint, motion)[:, 2]
    return float((inverse(columns.T @ columns)[0] @ columns.T @ friction)[1])


class _Filters(NamedTuple):
    """The filters with which `hil identify` would compute rate and acceleration of a motion: local polynomials, as
    impulse responses of odd length. step: time between two samples, s.
    """

    step: float
    slope: Array
    curvature: Array

    def gains(self, count: int) -> list[Spectrum]:
        """Return the frequency responses of both filters, for a Fourier transform of `count` samples."""
        return [
            np.fft.rfft(np.roll(np.pad(weights, (0, count - len(weights))), -(len(weights) // 2)))
            for weights in self[1:]
        ]


def _filters(motion: Response, angle_lsb: float) -> _Filters:
    readings = np.round(motion.dtheta / angle_lsb) * angle_lsb
    step = float(motion.time[1] - motion.time[0])
    slope, curvature = windows(motion.time, excited_band(motion.time, readings)[1])
    slope = narrowed(slope, step, angle_lsb / math.sqrt(12.0), hides_in_rate(motion.dtheta_dot))
    # the response at one sample to another's value: the slope's is odd, so the order matters
    return _Filters(step, kernel(slope, 1)[::-1] / step, kernel(curvature, 2)[::-1] / step**2)


def _noise(joint: Joint, readings: Readings, slope: Spectrum, curvature: Spectrum) -> Array:
    """Return the power density (m,), N^2 m^2, of the noise of torque and angle. slope, curvature (m,): the frequency
    responses with which the noise of the angle becomes that of rate and acceleration.
    """
    turned = joint.stiffness + joint.damping * slope
    if readings.motor_side:
        turned = turned + joint.friction * slope + joint.inertia * curvature
    return np.asarray(readings.white**2 + readings.angle_lsb**2 / 12.0 * np.abs(turned) ** 2)


def _bound(columns: Array, joint: Joint, readings: Readings, step: float) -> Array:
    """Return the inverse (p, p) of the Fisher information. The noise of the torque is white; that of the angle grows
    with frequency.
    """
    slope = np.asarray(2j * np.pi * np.fft.rfftfreq(_padded(len(columns)), step), np.complex128)
    return inverse(_form(columns, 1.0 / _noise(joint, readings, slope, slope**2)))[0]


@dataclass(frozen=True, slots=True)
class _Residual:
    """The noise that remains as residuals of the correct model.

    variance: N^2 m^2. at_zero: probability density at zero, 1/(N m). signs: spectrum (m,) of the covariance of the
    residuals' signs, relative to white noise.
    """

    variance: float
    at_zero: float
    signs: Array


def _residual(count: int, joint: Joint, readings: Readings, filters: _Filters) -> _Residual:
    """Return the residuals of the correct model for a motion of `count` samples. The covariance of the signs of
    Gaussian residuals is 2/pi times the arc sine of the residuals' correlation.
    """
    alike = np.fft.irfft(_noise(joint, readings, *filters.gains(_padded(count))))
    variance = float(alike[0])
    signs = 2.0 / np.pi * np.fft.rfft(np.arcsin(np.clip(alike / variance, -1.0, 1.0))).real
    return _Residual(variance, _density_at_zero(variance, 0.0 if readings.motor_side else readings.torque_lsb), signs)


def _absolute(columns: Array, misfit: Array, residual: _Residual) -> Array:
    """Return the covariance (p, p) of parameters that are estimated by least absolute deviations: A^-1 B A^-1.

    misfit (n,): the torque that the model does not describe, N m. A is twice the sum of x x' times the density of the
    residual at zero; B is the covariance of the sum of x times the sign of the residual. Where the misfit is larger
    than the noise, the noise hardly changes that density and that sign.
    """
    from scipy.special import ndtr

    density = residual.at_zero * np.maximum(np.exp(-(misfit**2) / (2.0 * residual.variance)), 1e-12)
    below = ndtr(misfit / math.sqrt(residual.variance))
    undecided = np.sqrt(4.0 * below * (1.0 - below))
    bread, _ = inverse(2.0 * (columns.T * density) @ columns)
    return np.asarray(bread @ _form(columns * undecided[:, None], residual.signs) @ bread)


def _density_at_zero(variance: float, lsb: float) -> float:
    """Return the probability density at zero, 1/(N m), of a Gaussian error plus rounding to counts of `lsb`. variance:
    of both together.
    """
    gaussian = math.sqrt(max(variance - lsb**2 / 12.0, 0.0))
    if lsb <= 1e-6 * gaussian:
        return 1.0 / (math.sqrt(2.0 * math.pi) * gaussian)
    return math.erf(lsb / (2.0 * math.sqrt(2.0) * gaussian)) / lsb if gaussian > 0.0 else 1.0 / lsb


def _filtered(joint: Joint, motion: Response, readings: Readings, filters: _Filters) -> Response:
    """Return the motion that `hil identify` would compute from readings without noise: with the delay of the torque and
    with filtered derivatives. The motion begins and ends at rest.
    """
    from scipy.signal import fftconvolve

    rate, acceleration = (fftconvolve(motion.dtheta, weights, mode="same") for weights in filters[1:])
    if readings.motor_side:
        late = motion.drive - readings.skew * np.gradient(motion.drive, filters.step)
        torque = late - joint.inertia * acceleration - joint.friction * rate
    else:
        change = joint.stiffness * motion.dtheta_dot + joint.damping * motion.acceleration
        torque = motion.torque - readings.skew * change
    return replace(motion, dtheta_dot=rate, acceleration=acceleration, torque=torque)


def _misfit(columns: Array, torque: Array, residual: _Residual) -> tuple[Array, Array]:
    """Return the parameters (p,) with the least mean absolute deviation in noise, and the residual torque (n,).

    The derivative of the mean of |m + e| over Gaussian e with respect to m is 2 Phi(m/sigma) - 1. So the minimum is a
    least-squares fit with the weights (2 Phi(m/sigma) - 1)/m, which is repeated until it converges.
    """
    from scipy.special import ndtr

    norms, sigma = np.linalg.norm(columns, axis=0), math.sqrt(residual.variance)
    scaled, weight = columns / norms, np.ones_like(torque)
    for _ in range(_REPEATS):
        fitted = np.linalg.solve((scaled.T * weight) @ scaled, (scaled.T * weight) @ torque)
        size = np.abs(torque - scaled @ fitted) + 1e-9 * sigma
        weight = (2.0 * ndtr(size / sigma) - 1.0) / size * sigma
    return fitted / norms, torque - scaled @ fitted


def _rough(terms: tuple[str, ...], joint: Joint, readings: Readings) -> Array:
    model = _model(terms)
    linear = [joint.stiffness, joint.damping, *np.zeros(len(model.linear) - 2)]
    return np.array([*linear, *(readings.skew for term in model.terms if term.delays)])


def _padded(count: int) -> int:
    """Return the number of samples of a Fourier transform that avoids wrap-around."""
    return 1 << (2 * count - 1).bit_length()


def _form(columns: Array, weight: Array) -> Array:
    """Return X' W X (p, p) for columns X (n, p) and a stationary matrix W, which is given by its spectrum (m,)."""
    count = 2 * (len(weight) - 1)
    spectra = np.fft.rfft(columns, count, axis=0)
    twice = np.full(len(weight), 2.0)  # each frequency but the first and the last stands for its negative too
    twice[0] = twice[-1] = 1.0
    return np.asarray(((np.conj(spectra).T * (weight * twice)) @ spectra).real / count)
