"""The predicted motion against closed forms, and against an integrator that shares nothing with it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from drivers.servo import Quantity
from hil.acquisition import excitation
from hil.acquisition.excitation import Profile
from hil.experiment_design.response import Joint, respond, set_points

JOINT = Joint(stiffness=0.02, damping=2e-4, inertia=3e-6, friction=1e-6)
RATE = 500.0


def make(kind: str, band: tuple[float, float], quantity: Quantity = Quantity.TORQUE) -> Profile:
    return excitation.make(
        kind, quantity, amplitude=0.005, default_amplitude=0.005, duration=4.0, band=band, rate=RATE, fade=0.2
    )


def gain(joint: Joint, frequency: float) -> complex:
    omega = 2.0 * np.pi * frequency
    return complex(joint.stiffness - joint.inertia * omega**2 + 1j * omega * (joint.damping + joint.friction))


@pytest.mark.parametrize("inertia", [3e-6, 0.0])
def test_a_torque_sine_moves_the_joint_as_the_transfer_function_says(inertia: float) -> None:
    joint = Joint(0.02, 2e-4, inertia, 1e-6)
    motion, _ = respond(joint, make("sine", (10.0, 10.0)), RATE)
    settled = (motion.time > 1.0) & (motion.time < 3.0)
    phasor = 2.0 * np.mean(motion.dtheta[settled][:-1] * np.exp(-2j * np.pi * 10.0 * motion.time[settled][:-1]))
    held = np.sinc(10.0 / RATE) * np.exp(-1j * np.pi * 10.0 / RATE)  # a set-point is held for a tick
    assert phasor == pytest.approx(-1j * 0.005 * held / gain(joint, 10.0), rel=2e-3)


def test_the_deflection_under_a_prbs_is_what_an_integrator_finds() -> None:
    profile = make("prbs", (0.5, 20.0))
    motion, found = respond(JOINT, profile, RATE)
    held = set_points(profile, RATE)[:200]
    state, seen, largest = np.zeros(2), [0.0], 0.0
    for torque in held[:-1]:
        ended = solve_ivp(
            lambda _, y, u=torque: [y[1], (u - 2.01e-4 * y[1] - 0.02 * y[0]) / 3e-6],
            (0.0, 1.0 / RATE),
            state,
            rtol=1e-9,
            atol=1e-12,
        )
        state = ended.y[:, -1]
        seen.append(state[0])
        largest = max(largest, float(np.abs(ended.y[1]).max()))
    np.testing.assert_allclose(motion.dtheta[:200], seen, atol=1e-8)
    assert found.velocity >= 0.98 * largest


def test_the_terms_of_equation_1_add_up_to_the_motors_torque() -> None:
    motion, _ = respond(JOINT, make("chirp", (0.5, 10.0)), RATE)
    middle = 0.5 * (motion.drive[1:-1] + motion.drive[2:])  # what is read before a tick and after it
    total = JOINT.inertia * motion.acceleration + JOINT.friction * motion.dtheta_dot + motion.torque
    np.testing.assert_allclose(total[1:-1], middle, atol=1e-9)


def test_a_prescribed_sine_takes_the_torque_that_the_transfer_function_says() -> None:
    motion, found = respond(JOINT, make("sine", (20.0, 20.0), Quantity.POSITION), RATE)
    assert found.deflection == pytest.approx(0.005, rel=0.005)
    assert found.drive == pytest.approx(0.005 * abs(gain(JOINT, 20.0)), rel=0.02)
    assert found.velocity == pytest.approx(0.005 * 40.0 * np.pi, rel=0.01)
    assert len(motion.time) == 2001


def test_a_resonance_far_above_the_tick_rate_is_seen_between_the_ticks() -> None:
    """Steps ring: an undamped spring overshoots to twice the torque, whichever instant the ticks fall on."""
    joint = Joint(stiffness=2.0, damping=1e-6, inertia=3e-6, friction=0.0)
    step = excitation.make(
        "prbs", Quantity.TORQUE, amplitude=1.0, default_amplitude=1.0, duration=0.5, band=(1.0, 5.0), rate=50.0
    )
    motion, found = respond(joint, step, 50.0)
    assert found.velocity > 1.02 * np.abs(motion.dtheta_dot).max()
    assert found.deflection < 2.0 * 2.0 * step.amplitude / 2.0
