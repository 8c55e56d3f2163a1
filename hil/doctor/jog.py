"""The jog: a small move of the motor, which shows whether the signs of the readings agree and whether the joint is
locked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Quantity, Servo
from drivers.torque_off import Alarm
from hil.acquisition import excitation
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.phases import Outcome
from hil.acquisition.recorder import Recorder, tick_count
from hil.acquisition.sink import Memory
from hil.stand.file import Stand

Array = NDArray[np.float64]

_FREQUENCY, _DURATION, _FADE = 1.0, 3.0, 0.5  # Hz, s, s: two whole swings between the fades
_FEW_COUNTS = 3.0
_ELASTIC = 0.7  # correlation of torque with deflection from which the joint counts as a locked spring
_RESIDUAL = 0.5  # of the swing, that may be left when the torque is zero again
_YIELDS = 0.2  # of the motor's swing, that a locked joint may turn


@dataclass(frozen=True, slots=True)
class Jog:
    """The readings of a jog.

    mode: what was commanded. motor, deflection, joint: peak-to-peak angles, rad (joint: NaN if not read). torque:
    peak-to-peak torque at the joint, N m. follows: correlation of the deflection with the command. torque_follows:
    correlation of the torque with the command. elastic: correlation of the torque with the deflection. residual:
    deflection at the end, divided by its peak-to-peak value. joint_follows: correlation of the torque cell's reading
    with the motor's torque, NaN if one is missing.
    """

    mode: Quantity
    motor: float
    deflection: float
    torque: float
    joint: float
    follows: float
    torque_follows: float
    elastic: float
    residual: float
    joint_follows: float

    def moved(self, position_lsb: float) -> bool:
        """Return whether the motor moved by more than its resolution. position_lsb: size of an encoder count, rad (NaN
        if unknown).
        """
        return self.motor > _FEW_COUNTS * (position_lsb if math.isfinite(position_lsb) else 1e-4)

    def wrong_signs(self) -> list[str]:
        """Return a sentence for each pair of readings with opposite signs."""
        wrong = []
        if self.follows < 0.0:
            wrong.append(f"a positive {self.mode} turns the motor backwards: its encoder and its command disagree")
        if self.mode is Quantity.TORQUE and self.torque_follows < 0.0:
            wrong.append("the torque reading has the opposite sign of the command: invert the sign of its source")
        if self.joint_follows < 0.0:
            wrong.append("the joint's sensor has the opposite sign of the motor: invert its sign in [joint_sensor]")
        return wrong

    def locked(self) -> tuple[bool, str]:
        """Return whether the joint is locked, and a sentence why."""
        if math.isfinite(self.joint):
            share = self.joint / max(self.deflection + self.joint, 1e-12)
            if share > _YIELDS:
                return False, f"the joint turned by {self.joint:.2g} rad, {share:.0%} of the motor's motion: lock it"
        if abs(self.elastic) < _ELASTIC or self.residual > _RESIDUAL:
            return False, (
                f"torque and deflection are not related as on a spring (correlation {self.elastic:.2f}, "
                f"{self.residual:.0%} of the swing remains): lock the joint, tighten the cable, or raise --amplitude"
            )
        stiffness = self.torque / max(self.deflection, 1e-12)
        return True, f"locked: it returns like a spring of about {stiffness * 1e3:.3g} mN m/rad"


def run_jog(
    stand: Stand, servo: Servo, mode: Quantity, stop: StopRequest, *, amplitude: float, rate: float, alarm: Alarm
) -> tuple[Outcome, Jog | None]:
    """Drive two swings of `amplitude` N m or rad at the joint, at `rate` Hz, with the recorder and its guard.

    The servo is disarmed on return. alarm: see `confirm_torque_off`. Return the outcome of the run, and the readings;
    the readings are None if there were too few replies.
    """
    profile = excitation.make(
        "sine",
        mode,
        amplitude=amplitude,
        default_amplitude=amplitude,
        duration=_DURATION,
        band=(_FREQUENCY, _FREQUENCY),
        rate=rate,
        fade=_FADE,
    )
    rows = Memory()
    outcome = Recorder(stand, servo, profile, rate, rows, alarm=alarm).run(stop)
    if outcome.error is not None or outcome.samples - outcome.lost < tick_count(profile, rate) // 2:
        return outcome, None
    return outcome, _evaluated(rows, stand, mode)


def _evaluated(rows: Memory, stand: Stand, mode: Quantity) -> Jog:
    names = ("command", "torque", "dtheta", "motor_position", "motor_torque", "joint_position", "joint_torque")
    answered = np.isfinite(rows.channel("dtheta"))
    command, torque, dtheta, motor, motor_torque, joint, joint_torque = (rows.channel(n)[answered] for n in names)
    if stand.stand.torque_source == "motor" and not np.isfinite(torque).any():
        torque = command
    return Jog(
        mode=mode,
        motor=float(np.ptp(motor)),
        deflection=float(np.ptp(dtheta)),
        torque=_swing(torque),
        joint=_swing(joint),
        follows=_correlation(command, dtheta),
        torque_follows=_correlation(command, torque),
        elastic=_correlation(torque, dtheta),
        residual=float(abs(np.mean(dtheta[-5:]) - np.mean(dtheta[:5]))) / max(float(np.ptp(dtheta)), 1e-12),
        joint_follows=_correlation(motor_torque, joint_torque),
    )


def _swing(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if len(finite) else math.nan


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation of two channels (n,), without rows in which either is NaN. NaN if a channel is
    constant.
    """
    both = np.isfinite(a) & np.isfinite(b)
    if np.count_nonzero(both) < 2 or np.ptp(a[both]) == 0.0 or np.ptp(b[both]) == 0.0:
        return math.nan
    return float(np.corrcoef(a[both], b[both])[0, 1])
