"""A third source of recordings: a joint that MuJoCo simulates, with its own springs, friction and integrator.

A hinge with MuJoCo's stiffness, damping and frictionloss follows the chirp of a case through a stiff servo. What a cell
between coupling and wall would read are the passive force and the friction of the joint, which MuJoCo computes; how
the joint moves is its affair too. Sensors read both as in the closed form.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from truth_cases import DURATION, Array, Case, Motion, Truth, chirp

STEP = 1e-4  # s, of the integrator: a sine of 15 Hz between two steps is a line within 1e-5 of its amplitude
BEFORE = 0.5  # s of the chirp's first sine before the first sample, in which the joint comes up to it
INERTIA = 3e-4  # kg m^2, of what the servo moves: its steps of torque do not shake the rate by 0.02 %
STIFF, DAMPED = 40.0, 0.2  # N m/rad and N m s/rad, of the servo, which follows 0.35 rad of chirp within 10 %

WITHOUT = ("backlash", "cubic", "motor side", "too slow", "standing still")  # what MuJoCo's joint has no parameter for


@dataclass(frozen=True, eq=False, slots=True)
class Driven:
    """What a joint did, on a grid `time` (n,) s: its motion, and the torque of its coupling, N m.

    It stands in for a `Case` where the sensors ask how the joint moves and what a perfect cell would show.
    """

    truth: Truth
    time: Array
    moved: Motion
    carried: Array

    def motion(self, time: Array) -> Motion:
        """The motion at `time` (m,) s."""
        parts = (self.moved.deflection, self.moved.rate, self.moved.acceleration)
        return Motion(*(np.interp(time, self.time, part) for part in parts))

    def torque(self, time: Array) -> Array:
        """The torque a perfect cell would show at `time` (m,) s, N m, late by the skew."""
        late = np.interp(time - self.truth.skew, self.time, self.carried)
        return np.asarray(late + self.truth.tau0 + self.truth.drift * time)


def driven(case: Case) -> Driven:
    """Return how MuJoCo moves the joint of a case. Raises ValueError for a case that it has no parameter for."""
    if case.name in WITHOUT:
        raise ValueError(f"MuJoCo's joint has no parameter for the case {case.name!r}")
    true = case.truth
    return Driven(true, *_simulated(case.band, true.Kc, true.Bc, true.Fc))


@functools.lru_cache(maxsize=4)  # the seeds of a case share the motion: only their sensors differ
def _simulated(
    band: tuple[float, float], stiffness: float, damping: float, friction: float
) -> tuple[Array, Motion, Array]:
    import mujoco

    model = mujoco.MjModel.from_xml_string(_joint(stiffness, damping, friction))
    state = mujoco.MjData(model)
    time = np.arange(round((DURATION + 2.0 * BEFORE) / STEP)) * STEP - BEFORE
    wanted = chirp(np.maximum(time, 0.0), band)
    wave = np.where(time < 0.0, 0.0, wanted.deflection), np.where(time < 0.0, 0.0, wanted.rate)
    found = np.empty((3, len(time)))
    for at, (deflection, rate) in enumerate(zip(*(part.tolist() for part in wave), strict=True)):
        state.ctrl[0] = STIFF * deflection + DAMPED * rate
        mujoco.mj_forward(model, state)
        cell = -(state.qfrc_passive[0] + state.qfrc_constraint[0])
        found[:, at] = state.qpos[0], state.qvel[0], cell
        mujoco.mj_step(model, state)
    deflection, rate, carried = found
    return time, Motion(deflection, rate, np.gradient(rate, STEP)), carried


def _joint(stiffness: float, damping: float, friction: float) -> str:
    """MuJoCo's model of a locked joint; the servo's own spring and damper stand outside of the joint's."""
    servo = f'gainprm="1" biastype="affine" biasprm="0 {-STIFF} {-DAMPED}"'
    return f"""
<mujoco>
  <option timestep="{STEP}" integrator="RK4" gravity="0 0 0"/>
  <worldbody><body>
    <joint name="coupling" axis="0 0 1" stiffness="{stiffness}" damping="{damping}" frictionloss="{friction}"
      solreffriction="{2 * STEP} 1" solimpfriction="0.999 0.999 0.001"/>
    <inertial pos="0 0 0" mass="1" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
  </body></worldbody>
  <actuator><general joint="coupling" {servo}/></actuator>
</mujoco>"""
