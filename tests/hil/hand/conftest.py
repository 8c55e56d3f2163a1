"""A simulated hand, whose joints differ in their stiffness."""

from __future__ import annotations

from ..conftest import hil

__all__ = ["hil"]

SIMULATED_HAND = """\
# the hand on the bench
[hand]
name = "bench hand"
backend = "sim"
repeats = 1
trials = 1
duration = 1
band = [0.5, 8.0]
model = "linear+offset"

[stand]
gear_ratio = 4.0
motor_inertia = "2 g*cm^2"
torque_source = "joint"

[limits]
torque = "30 mN*m"
deflection = 1.0
velocity = 100.0

[[joint]]
name = "soft"           # the little finger
sim.coupling.stiffness = 0.015
also_moves = {stiff = 0.5}

[[joint]]
name = "stiff"
stand.gear_ratio = 5.0  # counted
[joint.sim.coupling]
stiffness = 0.03
"""
