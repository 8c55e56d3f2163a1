"""What `hil doctor` does with a stand: connect, listen, arm and stop, and on request move a little and look.

Every way out leads through `disarm` and `close`; the move is a run of the recorder, under its guard, with the stand's
limits.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.gate import confirm_torque_off
from drivers.ports import can_interfaces, serial_problem
from drivers.servo import BadReply, DriverError, NoReply, Quantity, Servo, ServoInfo
from hil.acquisition.interrupt import StopRequest
from hil.doctor.checks import Examination, Verdict
from hil.doctor.jog import Movement, move_a_little
from hil.doctor.link_test import judge_readings, listen, manageable
from hil.doctor.stop_path import exercise_stop, fall_silent
from hil.stand.devices import check_backend, found_by_search
from hil.stand.file import Stand
from hil.stand.opening import open_servo
from hil.stand.transmission import Transmission

_SMALL = 1.0 / 20.0  # of a limit


def examine(
    found: Examination, stand: Stand, quantity: Quantity, *, rate: float, move: bool, amplitude: float | None = None
) -> None:
    """Look at everything, as far as it goes; what is wrong goes into `found`. The torque is off on return.

    rate: Hz that the link is to manage. move: whether the motor may be driven, by `amplitude` N m or rad at the joint
    (None: a twentieth of the limit). Raises WrongUse where the stand file does not suffice.
    """
    stand.checked_limits()
    check_backend(stand.stand.backend)
    _look_at_the_port(found, stand)
    with StopRequest().listening() as stop:
        with _connected(found, stand, quantity) as servo:
            samples = [] if servo is None else listen(found, servo, rate, stop)
            if servo is not None and samples and not stop.count and judge_readings(found, stand, samples):
                limits = Transmission.of(stand.stand).motor_limits(stand.checked_limits(), samples[-1].motor_position)
                exercise_stop(found, servo, limits, quantity)
                if move and not stop.count:
                    _move(found, stand, servo, (quantity, amplitude, rate), stop)
                if not stop.count:  # last, since it may leave a fault that only cutting the power clears
                    fall_silent(found, servo, limits, _watchdog(stand))
        found.signal = stop.number
    if found.ok and not move:
        found.add("signs, lock", Verdict.SKIPPED, "nothing was moved: add --move, with nobody's hand in the joint")


def _look_at_the_port(found: Examination, stand: Stand) -> None:
    """The serial port or the CAN interface that the drive's table names, where it is this machine's."""
    table = stand.devices.get(str(stand.stand.backend))
    interface = getattr(table, "interface", None)
    name = getattr(table, "port", None) if interface is None else getattr(table, "channel", None)
    if not isinstance(name, str) or "://" in name:
        return
    if interface in {None, "slcan"}:
        problem = serial_problem(Path(name.partition("@")[0]))
    elif interface == "socketcan":
        seen = {port.name: port.problem for port in can_interfaces()}
        problem = seen.get(name, f"there is no CAN interface {name}: plug its adapter in, or correct the channel")
    else:
        return
    found.add("port", Verdict.PROBLEM if problem else Verdict.OK, problem or f"{name} can be used")


def _watchdog(stand: Stand) -> float:
    """s of silence after which the drive stops by itself, 0 where it does not."""
    if stand.stand.backend == "sim":
        return float(stand.sim.link.watchdog)
    return float(getattr(stand.devices.get(str(stand.stand.backend)), "watchdog", 0.0) or 0.0)


@contextmanager
def _connected(found: Examination, stand: Stand, quantity: Quantity) -> Iterator[Servo | None]:
    """The servo, its torque off and let go of afterwards; None where it cannot be had."""
    try:
        servo, _ = open_servo(stand, quantity=quantity)
    except DriverError as error:
        found.add("connection", Verdict.PROBLEM, f"{error}{_searched(stand, error)}")
        yield None
        return
    try:
        found.info = servo.info
        found.add("connection", Verdict.OK, _identity(servo.info))
        yield servo
    except DriverError as error:
        found.add("drive", Verdict.PROBLEM, str(error))
    finally:
        try:
            _torque_off(found, servo)
        finally:
            servo.close()


def _torque_off(found: Examination, servo: Servo) -> None:
    result = confirm_torque_off(servo)
    if not result.confirmed:
        found.add("torque off", Verdict.PROBLEM, result.alarm)
    if result.error is not None and not isinstance(result.error, Exception):
        raise result.error


def _searched(stand: Stand, error: DriverError) -> str:
    """Who else answers on a link where the one that was asked does not."""
    name = check_backend(stand.stand.backend)
    if not isinstance(error, NoReply | BadReply):
        return ""
    try:
        others = found_by_search(name, stand.devices[name])
    except DriverError:
        return ""
    return f". But {'; '.join(others)}: correct the stand file" if others else ""


def _move(
    found: Examination,
    stand: Stand,
    servo: Servo,
    wanted: tuple[Quantity, float | None, float],
    stop: StopRequest,
) -> None:
    quantity, amplitude, rate = wanted
    limits = stand.checked_limits()
    limit = limits.torque if quantity is Quantity.TORQUE else limits.deflection
    size = min(limit, limit * _SMALL if amplitude is None else amplitude)
    if found.bus is not None:
        rate = manageable(found.bus, rate)
    outcome, movement = move_a_little(stand, servo, quantity, stop, amplitude=size, rate=rate)
    if outcome.error is not None:
        found.add("move", Verdict.PROBLEM, str(outcome.error))
    elif movement is None:
        found.add("move", Verdict.PROBLEM, "it was stopped before anything could be told")
    else:
        _judge_movement(found, movement, servo.info)


def _judge_movement(found: Examination, movement: Movement, info: ServoInfo) -> None:
    if not movement.moved(info.position_lsb):
        said = f"the motor moved by {movement.motor:.2g} rad only: raise --amplitude, or look for what blocks it"
        found.add("move", Verdict.PROBLEM, said)
        return
    found.add("move", Verdict.OK, f"{movement.deflection:.3g} rad of deflection, {movement.torque * 1e3:.3g} mN m")
    wrong = movement.wrong_signs()
    right = (
        "command, position and torque agree; the first swing was a positive command: if that went the way you call "
        "negative, turn the sign in the drive's table"
    )
    found.add("signs", Verdict.PROBLEM if wrong else Verdict.OK, "; ".join(wrong) or right)
    locked, said = movement.locked()
    found.add("lock", Verdict.OK if locked else Verdict.PROBLEM, said)


def _identity(info: ServoInfo) -> str:
    words = [f"{info.backend} {info.model}", info.serial, f"firmware {info.firmware}" if info.firmware else ""]
    if math.isfinite(info.position_lsb):
        words.append(f"one count is {info.position_lsb * 1e3:.3g} mrad")
    if math.isfinite(info.torque_lsb):
        words.append(f"or {info.torque_lsb * 1e3:.3g} mN m")
    if math.isfinite(info.torque_uncertainty):
        words.append(f"torque scale within {info.torque_uncertainty * 100:.0f} %")
    return ", ".join(word for word in words if word)
