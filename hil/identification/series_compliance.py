"""Compute the coupling of a joint whose fixture is not rigid, from its own recording and an empty-rig recording.

Coupling and fixture carry the same torque, and their deflections add: 1/Z_measured = 1/Z_coupling + 1/Z_fixture, each Z
= K + j w B. At rest that is 1/K_measured = 1/Kc + 1/K_fixture, and for slow motion B_measured/K_measured^2 = Bc/Kc^2 +
B_fixture/K_fixture^2. But two such elements in series are not a single spring and damper: their stiffness rises with
frequency, and a fit of K and B depends on the excitation. The function `series` makes that fit, by least squares over
the spectrum of the deflection; `corrected` finds the coupling for which the fit gives the measured K and B. The closed
forms above are the limit if 2 pi f B/K is small for both elements. Over the paper's band, up to its joint's corner at
15 Hz, they are wrong by a third of the correction.

The correction is valid while the joint's own inertia, between the two springs, carries little of the torque: well below
sqrt((Kc + K_fixture)/J)/(2 pi).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ga.arrays import Array
from hil.errors import Untrustworthy
from hil.signals.constants import CURVE_POINTS, DEPENDENT, NEWTON_LIMIT
from hil.signals.rate.spectrum import power_of


@dataclass(frozen=True, slots=True)
class Element:
    """A spring and damper in parallel with standard errors: K, N m/rad, and B, N m s/rad."""

    stiffness: float
    damping: float
    stiffness_error: float = 0.0
    damping_error: float = 0.0


@dataclass(frozen=True, slots=True)
class Excitation:
    """The excitation of a recording. frequency (n,): Hz. power (n,): the deflection's power at these frequencies, in
    any unit.
    """

    frequency: Array
    power: Array

    @classmethod
    def flat(cls, band: tuple[float, float]) -> Excitation:
        """Return equal power at every frequency of the band, Hz, as in a linear chirp of the deflection."""
        frequency = np.linspace(*band, CURVE_POINTS)
        return cls(frequency, np.ones_like(frequency))

    @classmethod
    def of(cls, time: Array, dtheta: Array) -> Excitation:
        """Return the excitation of a recording: deflection (n,) rad at times (n,) s, which need not be evenly
        spaced.
        """
        frequency, power, _ = power_of(time, dtheta)
        return cls(frequency, power)


def corrected(measured: Element, fixture: Element, excitation: Excitation) -> Element:
    """Return the coupling alone, with the errors of both recordings propagated to first order.

    measured: stiffness and damping from the recording of the joint. fixture: those from the empty-rig recording.
    excitation: the excitation of the joint's recording. If a damping is not identifiable, its error is infinite, and so
    is that of the coupling's damping. Raises Untrustworthy if the fixture is softer than the coupling, or if both
    together have no stiffness.
    """
    _refuse_soft_fixture(measured, fixture)
    target = np.array([measured.stiffness, measured.damping])
    held = np.array([fixture.stiffness, fixture.damping])
    found = _closed_form(target, held)
    small = DEPENDENT * target[0] * np.array([1.0, 1.0 / (2.0 * np.pi * excitation.frequency.max())])
    for _ in range(NEWTON_LIMIT):
        step = np.linalg.solve(_jacobian(found, held, excitation), target - series(found, held, excitation))
        found = found + step
        if np.all(np.abs(step) <= small):
            break
    else:
        raise Untrustworthy("the fixture's correction does not converge: its damping is too large for its stiffness")
    errors = _propagated(found, held, excitation, measured, fixture)
    return Element(float(found[0]), float(found[1]), *errors)


def series(first: Array, second: Array, excitation: Excitation) -> Array:
    """Return K and B (2,) of the spring and damper that fits two elements (2,) in series, by least squares over the
    excitation.
    """
    omega = 2.0 * np.pi * excitation.frequency
    one, other = (element[0] + 1j * omega * element[1] for element in (first, second))
    together = one * other / (one + other)
    power = excitation.power
    return np.array([power @ together.real / power.sum(), (power * omega) @ together.imag / (power @ omega**2)])


def _closed_form(target: Array, held: Array) -> Array:
    """Return K and B of the coupling in the limit of slow motion. target: measured K and B. held: K and B of
    the fixture.
    """
    stiffness = 1.0 / (1.0 / target[0] - 1.0 / held[0])
    damping = stiffness**2 * (target[1] / target[0] ** 2 - held[1] / held[0] ** 2)
    return np.array([stiffness, damping])


def _jacobian(first: Array, second: Array, excitation: Excitation) -> Array:
    """Return the derivative (2, 2) of `series` with respect to the first element: (Z2/(Z1 + Z2))^2 times dZ1."""
    omega = 2.0 * np.pi * excitation.frequency
    one, other = (element[0] + 1j * omega * element[1] for element in (first, second))
    share = (other / (one + other)) ** 2
    power = excitation.power
    columns = [[power @ part.real, (power * omega) @ part.imag] for part in (share, 1j * omega * share)]
    found: Array = np.array(columns).T / np.array([[power.sum()], [power @ omega**2]])
    return found


def _propagated(
    found: Array, held: Array, excitation: Excitation, measured: Element, fixture: Element
) -> tuple[float, float]:
    """Return the standard errors of the corrected stiffness and damping from the independent errors of both
    recordings.
    """
    of_measured = np.linalg.inv(_jacobian(found, held, excitation))
    of_fixture = -of_measured @ _jacobian(held, found, excitation)
    errors = np.array(
        [measured.stiffness_error, measured.damping_error, fixture.stiffness_error, fixture.damping_error]
    )
    known = np.isfinite(errors)
    square = (np.hstack([of_measured, of_fixture])[:, known] * errors[known]) ** 2
    stiffness, damping = np.sqrt(square.sum(axis=1))
    stiffness_known = bool(known[[0, 2]].all())
    return (
        float(stiffness) if stiffness_known else np.inf,
        float(damping) if known.all() else np.inf,
    )


def _refuse_soft_fixture(measured: Element, fixture: Element) -> None:
    """Raise Untrustworthy unless joint and fixture together have a stiffness above zero, N m/rad, and the fixture is
    stiffer than the joint.
    """
    if not measured.stiffness > 0.0:
        raise Untrustworthy(
            f"Kc of joint and fixture together is {measured.stiffness:.4g} N m/rad, not above zero, so Kc of the joint "
            "alone cannot be identified. Run hil identify again without --fixture, and follow its warnings and errors"
        )
    if 2.0 * measured.stiffness < fixture.stiffness:  # 1/K_fixture is less than half of 1/K_measured
        return
    raise Untrustworthy(
        f"the fixture ({fixture.stiffness:.4g} N m/rad) is softer than the joint: together they have "
        f"{measured.stiffness:.4g} N m/rad. Kc and Bc of the joint cannot be identified behind it. Stiffen the fixture "
        "and record both again"
    )
