"""A joint that MuJoCo simulates, with its own springs, friction and integrator: the third source of recordings.

A hinge follows a deflection through a stiff servo; how it moves is MuJoCo's affair. What a cell between coupling and
wall would read are the passive force and the friction of the hinge, which MuJoCo computes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INERTIA = 3e-4  # kg m^2, of what the servo moves: its steps of torque do not shake the rate by 0.02 %
STIFF, DAMPED = 40.0, 0.2  # N m/rad and N m s/rad, of the servo, which follows 0.35 rad of chirp within 10 %
SOFTEST = 0.3  # N m/rad, of a joint up to which the servo is that stiff; beyond, all three grow with the joint
STABLE = 1.5  # pole of a branch's body, per step of the integrator, which is stable up to 2.8


@dataclass(frozen=True, slots=True)
class Joint:
    """What MuJoCo's hinge and its tendons couple with, SI; zero: nothing of that kind.

    stiffness, damping: N m/rad, N m s/rad. cubic: N m/rad^3. quadratic: N m s^2/rad^2. friction: N m, dry. gap: rad in
    which the spring, then a tendon's, is slack; the damping acts there too. yielding: N m/rad of a spring beside that
    yields `reach` rad from where it is unloaded: friction that builds up. branch: N m/rad of a Maxwell branch that
    relaxes in `relaxing` s.
    """

    stiffness: float
    damping: float
    cubic: float = 0.0
    quadratic: float = 0.0
    friction: float = 0.0
    gap: float = 0.0
    yielding: float = 0.0
    reach: float = 0.01
    branch: float = 0.0
    relaxing: float = 0.0


def simulated(joint: Joint, step: float, deflection: Array, rate: Array) -> tuple[Array, Array, Array]:
    """Return deflection, rate and torque of the coupling, (n,) each, SI, for a wanted deflection and rate (n,).

    step: s, of the integrator. The hinge begins where the wanted motion does, and everything else unloaded.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(_model(joint, step))
    state = mujoco.MjData(model)
    state.qpos[0], state.qvel[0] = deflection[0], rate[0]
    size = _size(joint)
    commands = (size * (STIFF * deflection + DAMPED * rate)).tolist()
    found = np.empty((3, len(commands)))
    for at, command in enumerate(commands):
        state.ctrl[0] = command
        mujoco.mj_forward(model, state)
        cell = -(state.qfrc_passive[0] + state.qfrc_constraint[0])
        found[:, at] = state.qpos[0], state.qvel[0], cell
        mujoco.mj_step(model, state)
    return found[0], found[1], found[2]


def _model(joint: Joint, step: float) -> str:
    """MuJoCo's model of a locked joint; the servo's own spring and damper stand outside of the joint's."""
    size = _size(joint)
    servo = f'gainprm="1" biastype="affine" biasprm="0 {-size * STIFF} {-size * DAMPED}"'
    spring = f"{joint.stiffness} 0 {joint.cubic}"
    tendons = _fixed(spring, f'springlength="{-0.5 * joint.gap} {0.5 * joint.gap}"') if joint.gap else ""
    if joint.yielding:
        tendons += _fixed(f"{joint.yielding}", f'springlength="0 0" springyield="{joint.reach}"')
    branch = ""
    if joint.branch:  # a damper that holds a light body, to which a spring leads
        held = joint.branch * joint.relaxing
        branch = f'<body><joint name="branch" axis="0 0 1" damping="{held}"/>{_inertial(held * step / STABLE)}</body>'
        tendons += _fixed(f"{joint.branch}", 'springlength="0 0"', '<joint joint="branch" coef="-1"/>')
    return f"""
<mujoco>
  <compiler boundinertia="0"/>
  <option timestep="{step}" integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="coupling" axis="0 0 1" stiffness="{"0" if joint.gap else spring}"
        damping="{joint.damping} {joint.quadratic}" frictionloss="{joint.friction}"
        solreffriction="{2 * step} 1" solimpfriction="0.999 0.999 0.001"/>
      {_inertial(size * INERTIA)}
    </body>
    {branch}
  </worldbody>
  <tendon>{tendons}</tendon>
  <actuator><general joint="coupling" {servo}/></actuator>
</mujoco>"""


def _size(joint: Joint) -> float:
    return max(1.0, joint.stiffness / SOFTEST)


def _inertial(moment: float) -> str:
    return f'<inertial pos="0 0 0" mass="1" diaginertia="{moment} {moment} {moment}"/>'


def _fixed(stiffness: str, spring: str, beside: str = "") -> str:
    return f'<fixed stiffness="{stiffness}" {spring}><joint joint="coupling" coef="1"/>{beside}</fixed>'
