"""The predicted motion of a locked joint under an excitation: equation (1) with the coupling of equation (2).

All quantities are at the joint. A torque command is constant from tick to tick, and the motor's inertia resonates with
the coupling's spring. A position command prescribes the deflection, and equation (1) gives the torque. The joint does
not move; dry friction, play and the fixture's compliance are left out.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Quantity
from hil.acquisition.excitation import Profile

Array = NDArray[np.float64]

_POINTS = 32  # in a period of the fastest motion, which give its peak within 1 %
_FEWEST, _MOST = 4, 64  # steps between two ticks


@dataclass(frozen=True, slots=True)
class Joint:
    """A coupling with stiffness Kc, N m/rad, and damping Bc, N m s/rad, and the motor as it acts at the joint.

    inertia: of the motor, eta^2 Dm, kg m^2, 0 if unknown. friction: viscous friction of the motor, eta^2 Bm, N m s/rad.
    """

    stiffness: float
    damping: float
    inertia: float
    friction: float

    @property
    def corner(self) -> float:
        """The frequency above which the damper carries more torque than the spring, Kc/(2 pi Bc), Hz."""
        return self.stiffness / (2.0 * math.pi * self.damping)

    @property
    def resonance(self) -> float:
        """The undamped resonance frequency of motor and coupling, Hz; infinite for a motor without inertia."""
        return math.sqrt(self.stiffness / self.inertia) / (2.0 * math.pi) if self.inertia else math.inf


@dataclass(frozen=True, slots=True)
class Response:
    """The predicted motion at the ticks, as arrays (n,).

    time: s. dtheta: deflection, rad, with its rate dtheta_dot, rad/s, and acceleration, rad/s^2. torque: in the
    coupling, N m. drive: torque of the motor, N m, read at a tick before that tick's set-point acts.
    """

    time: Array
    dtheta: Array
    dtheta_dot: Array
    acceleration: Array
    torque: Array
    drive: Array


class Peaks(NamedTuple):
    """The largest magnitudes during a run, at the joint.

    drive: torque of the motor, N m. torque: torque in the coupling, N m. deflection: rad. velocity: rad/s.
    """

    drive: float
    torque: float
    deflection: float
    velocity: float


def respond(joint: Joint, profile: Profile, rate: float) -> tuple[Response, Peaks]:
    """Return the motion at `rate` Hz, and the peaks of the motion, also between the ticks."""
    return _responder(profile, rate)(joint)


def peaks(joints: list[Joint], profile: Profile, rate: float) -> list[Peaks]:
    """Return the peaks of the motion for each of the joints."""
    answer = _responder(profile, rate)
    return [answer(joint)[1] for joint in joints]


def _responder(profile: Profile, rate: float) -> Callable[[Joint], tuple[Response, Peaks]]:
    if profile.mode is Quantity.TORQUE:
        return partial(_driven, command=set_points(profile, rate), rate=rate)
    fine = max(1, math.ceil(_POINTS * profile.band[1] / rate))
    steps = fine if profile.excitation.smooth else _FEWEST
    step = 1.0 / (rate * steps)
    dtheta = profile.at(np.arange(round(profile.duration * rate) * steps + 1, dtype=np.float64) * step)
    velocity = np.gradient(dtheta, step)
    return partial(_prescribed, course=(dtheta, velocity, np.gradient(velocity, step)), steps=steps, rate=rate)


def set_points(profile: Profile, rate: float) -> Array:
    """Return the command at each tick, (n,) N m or rad, as the recorder sends it."""
    return profile.at(np.arange(round(profile.duration * rate) + 1) / rate)


def _driven(joint: Joint, command: Array, rate: float) -> tuple[Response, Peaks]:
    steps = min(_MOST, max(_FEWEST, math.ceil(_POINTS * min(joint.resonance, _MOST * rate) / rate)))
    dtheta, velocity = _oscillator(joint, np.repeat(command[:-1], steps), 1.0 / (rate * steps))
    torque = joint.stiffness * dtheta + joint.damping * velocity
    angle, speed, carried = (values[::steps] for values in (dtheta, velocity, torque))
    before = np.append(0.0, command[:-1])
    if joint.inertia:  # it jumps at a tick; the mean of both sides is what an average over a few ticks gives
        acceleration = (0.5 * (before + command) - carried - joint.friction * speed) / joint.inertia
    else:
        acceleration = np.gradient(speed, 1.0 / rate)
    motion = Response(np.arange(command.size) / rate, angle, speed, acceleration, carried, before)
    return motion, _peaks(command, torque, dtheta, velocity)


def _oscillator(joint: Joint, command: Array, step: float) -> tuple[Array, Array]:
    """Return deflection and rate (n + 1,) under torques (n,), each constant for `step` s, from rest. The solution is
    exact at each step.

    J d'' + b d' + Kc d = u has the poles p and q, which advance the state by a step; this recursion is computed as a
    second-order filter. An inertia of zero is replaced by an inertia so small that it has no effect.
    """
    from scipy.signal import lfilter

    damping = joint.damping + joint.friction
    least = min(1e-3 * step * damping, damping**2 / (8.0 * joint.stiffness))
    inertia = joint.inertia or least
    half, square = damping / (2.0 * inertia), joint.stiffness / inertia
    apart = cmath.sqrt(half**2 - square)
    if abs(apart) < 1e-6 * half:  # a double pole, which is as good as two that are this near
        apart = complex(1e-6 * half)
    p = -half - apart
    q = square / p
    first, second = cmath.exp(p * step), cmath.exp(q * step)
    carried = np.array([[0.0, 1.0], [-square, -2.0 * half]]) * ((second - first) / (q - p)).real
    state = carried + np.eye(2) * ((q * first - p * second) / (q - p)).real
    entry = (np.eye(2) - state)[:, 0] / joint.stiffness  # from rest at one deflection to rest at another
    trace, determinant = float(np.trace(state)), (first * second).real
    delayed = (state - trace * np.eye(2)) @ entry  # of the adjugate of zI - A, which is zI - (tr A) I + A
    entering = np.append(command, 0.0)
    found = [
        np.asarray(lfilter([0.0, entry[row], delayed[row]], [1.0, -trace, determinant], entering)) for row in (0, 1)
    ]
    return found[0], found[1]


def _prescribed(joint: Joint, course: tuple[Array, Array, Array], steps: int, rate: float) -> tuple[Response, Peaks]:
    """Return motion and peaks for a prescribed deflection. course: deflection, rate and acceleration at `steps` points
    a tick.
    """
    dtheta, velocity, acceleration = course
    torque = joint.stiffness * dtheta + joint.damping * velocity
    drive = torque + joint.inertia * acceleration + joint.friction * velocity  # equation 1
    ticks = [values[::steps] for values in (*course, torque, drive)]
    return Response(np.arange(len(ticks[0])) / rate, *ticks), _peaks(drive, torque, dtheta, velocity)


def _peaks(*values: Array) -> Peaks:
    return Peaks(*(float(np.abs(one).max()) for one in values))
