"""A simulated hand whose palm and locks yield: how far its other motors turn, and the guard for them.

A torque T in a coupling Kc turns its joint's lock by T/Kf, and the palm, in series, by T/Kp.
"""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from drivers.clock import VirtualClock
from drivers.servo import Command, Limits, Quantity
from hil.hand.file import parse
from sim_backend.servo import SimServo
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.tables import MODELS
from sim_backend.wire.packets.regulator import joint_at_horn
from sim_backend.wire.packets.servos import OnLine, servos

from ..conftest import Hil

KC, KF, TORQUE, COUNT = 0.02, 5.0, 2e-3, math.tau / 4096
HAND = """\
[hand]
backend = "sim"
[stand]
gear_ratio = 4.0
torque_source = "joint"
[limits]
torque = 0.03
deflection = 1.0
velocity = 100.0
[sim]
coupling = {{stiffness = {kc}, coulomb_friction = 0.0}}
fixture = {{stiffness = {kf}, palm = {kp}}}
sensors = {{torque_cell_noise = 0.0}}
link = {{watchdog = 100.0}}
[[joint]]
name = "flexor"
moves = "mcp"
also_moves = {{pip = {turns}}}
[[joint]]
name = "pip"
stand.gear_ratio = 6.0
[[joint]]
name = "thumb"
"""


def hand_text(kp: float, turns: float) -> str:
    return HAND.format(kc=KC, kf=KF, kp=kp, turns=turns)


@pytest.mark.parametrize(("kp", "turns"), [(0.3, 0.75), (0.3, -0.5), (2.0, 0.75)])
def test_a_yielding_palm_turns_the_neighbours_as_its_torque_says(kp: float, turns: float) -> None:
    stand = parse(hand_text(kp, turns)).joint("flexor").stand
    servo = SimServo(stand.simulated(), seed=0, clock=VirtualClock(), neighbours=stand.simulated_neighbours())
    servo.arm(Limits(5e-3, 1e3, 80.0, (-10.0, 10.0)))
    servo.exchange(Command(Quantity.TORQUE, TORQUE / 4.0))
    servo.clock.sleep_until(60.0)
    angle = servo.exchange(Command(Quantity.TORQUE, TORQUE / 4.0)).motor_position
    seen = servo.turned()
    servo.close()
    palm = TORQUE * (1.0 + turns) / kp  # the sum of the torques of both joints that the tendon bends
    pip = turns * TORQUE / KF + palm
    assert seen["thumb"] == pytest.approx(4.0 * palm, abs=COUNT)
    assert seen["pip"] == pytest.approx(6.0 * abs(pip), abs=COUNT)
    assert angle == pytest.approx(4.0 * (TORQUE / KC + TORQUE / KF + palm + turns * pip), abs=2 * COUNT)


@pytest.mark.parametrize(("stiffer", "status"), [(1.5, 3), (3.0, 0)])
def test_a_motor_that_turns_half_as_far_as_the_driven_one_ends_the_run(hil: Hil, stiffer: float, status: int) -> None:
    """With gears of 4 and 6, for a palm of about twice the stiffness: 6 / Kp = 0.5 * 4 * (1 / Kc + 1 / Kp)."""
    Path("hand.toml").write_text(hand_text(stiffer * KC, 1e-3))
    words = ("--profile", "sine", "--band", 1, "--duration", 2, "--amplitude", 3e-3, "-o", "run.h5")
    ended = hil("record", "--stand", "hand.toml", "--joint", "thumb", *words)
    assert ended.status == status, ended.err
    assert ("the motor is driven and turned by " in ended.err) == bool(status)
    assert ("and that of pip turned by " in ended.err) == bool(status)


def test_an_emulated_servo_that_is_off_turns_with_the_lock_of_its_neighbour() -> None:
    model, turns = "xl330-m288", 400.0
    wanted = [OnLine(model, 1, turns={2: turns}), OnLine(model, 2)]
    made = servos(DynamixelDevice, MODELS, wanted, highest=9, baudrate=57600, rates=(57600,), log=None)
    first, second = made
    before = second.registers.get("present_position")
    first.write(11, b"\0")
    first.write(64, b"\1")
    first.write(102, (100).to_bytes(2, "little"))
    for servo in made:
        servo.life.run(servo.life.powered + 5.0)
        servo.read(132, 4, servo.life.now)
    expected = turns * first.motor.torque / joint_at_horn(MODELS[model], None).fixture.stiffness / COUNT
    assert expected > 10
    assert second.registers.get("present_position") - before == pytest.approx(expected, abs=1.0)
