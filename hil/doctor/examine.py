"""The checks of `hil doctor`: connect, test the link, arm and stop, and on request move the motor a little (the jog).

Every path ends in `disarm` and `close`. The jog is a run of the recorder: its guard checks the stand's limits.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivers.ports import can_interfaces, serial_problem
from drivers.servo import BadReply, DriverError, NoReply, Quantity, Servo, ServoInfo
from drivers.torque_off import confirm_torque_off
from hil.acquisition.commissioning import NOTHING_TURNS, Agree, require_agreement, require_release
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.real_time import PERMISSION, connecting, missing_permissions
from hil.doctor.checks import CheckList, Verdict, called
from hil.doctor.commission import Report, commission
from hil.doctor.jog import Jog, run_jog
from hil.doctor.keys import keys_of
from hil.doctor.link_check import check_link, check_readings, reachable
from hil.doctor.stop_path import check_overload, check_stop, check_watchdog
from hil.doctor.tune import tune
from hil.errors import WrongUse
from hil.guardian.servo import Watch
from hil.stand.devices import check_backend, found_by_search, restrictions
from hil.stand.file import LimitsTable, Stand
from hil.stand.opening import limits_below_one_count, open_servo, refused_neighbours, require_watchdog
from hil.stand.transmission import Transmission

_WATCH = Watch(silence=0.25, longest=60.0)  # the torque is small here, and a slow computer is to be examined too
_SMALL = 1.0 / 20.0  # of a limit


def examine(
    checks: CheckList,
    stand: Stand,
    mode: Quantity,
    *,
    rate: float,
    move: bool,
    amplitude: float | None = None,
    tuned: bool = False,
    say: Callable[[str], object] | None = None,
    agree: Agree | None = None,
    search: Callable[[str, Any], list[str]] = found_by_search,
) -> Report | None:
    """Make every check that the stand allows and add each to `checks`. The torque is off on return.

    rate: the rate that the link must reach, Hz. move: whether the motor may be driven. amplitude: of this move, N m or
    rad at the joint (None: a twentieth of the limit). tuned: whether to search for the highest rate. say: if given, the
    drive is also commissioned, and `say` is called with a sentence before each trial. agree: called before anything is
    opened if `move` moves a real motor for the first time. search: called for a drive that does not answer. Return the
    result of commissioning, None without it. Raises WrongUse if the stand file is incomplete for the checks, and the
    errors of `agree` and `commission`.
    """
    size = _jog_size(stand.checked_limits(), mode, amplitude)
    check_backend(stand.stand.backend)
    checks.keys = keys_of(stand)
    _check_port(checks, stand)
    _check_real_time(checks)
    for text in restrictions(stand.devices.get(str(stand.stand.backend)), stand.stand.torque_source):
        checks.add("drive", Verdict.WARNING, text)
    if move:
        unit = "N m" if mode is Quantity.TORQUE else "rad"
        require_agreement(stand, mode, f"will swing with up to {size:.3g} {unit} at the joint for 3 s.", agree)
    with StopRequest().listening() as stop:
        with _connected(checks, stand, mode, search) as servo:
            samples = [] if servo is None else check_link(checks, servo, rate, stop)
            ready = servo is not None and samples and not stop.count and check_readings(checks, stand, samples)
            if servo is not None and ready and _check_neighbours(checks, stand, servo) and not stop.count:
                limits = Transmission.of(stand.stand).motor_limits(stand.checked_limits(), samples[-1].motor_position)
                check_overload(checks, servo, limits)
                check_stop(checks, servo, limits, mode)
                if move and not stop.count:
                    _move(checks, stand, servo, (mode, size, rate), stop)
                if (
                    not stop.count and say is None
                ):  # last, since it may leave a fault that only cutting the power clears
                    check_watchdog(checks, servo, limits)
        if tuned and checks.ok and not stop.count:
            tune(checks, stand, mode, stop)
        checks.signal = stop.number
    if say is not None and checks.ok and not checks.signal:
        return commission(checks, stand, mode, say)
    if checks.ok and not move:
        checks.add("signs, lock", Verdict.SKIPPED, "nothing was moved: add --move, with nobody's hand in the joint")
    return None


def _check_port(checks: CheckList, stand: Stand) -> None:
    """Check that this computer has the serial port or CAN interface that the drive's table names."""
    table = stand.devices.get(str(stand.stand.backend))
    interface = getattr(table, "interface", None)
    name = getattr(table, "port", None) if interface is None else getattr(table, "channel", None)
    if not isinstance(name, str) or "://" in name:
        return
    if interface in {None, "slcan", "damiao"}:
        problem = serial_problem(Path(name.partition("@")[0]))
    elif interface == "socketcan":
        seen = {port.name: port.problem for port in can_interfaces()}
        problem = seen.get(name, f"there is no CAN interface {name}: plug its adapter in, or correct the channel")
    else:
        return
    checks.add("port", Verdict.ERROR if problem else Verdict.OK, problem or f"{name} can be used")


def _check_real_time(checks: CheckList) -> None:
    """Check that this user may run the control loop with real-time priority."""
    if sys.platform != "linux":
        return
    missing = missing_permissions()
    if missing:
        message = f"{' and '.join(missing)} not permitted, so ticks come later on a busy computer: {PERMISSION}"
        checks.add("real time", Verdict.WARNING, message)
    else:
        checks.passed("real time", "the control loop runs before other programs, with its memory locked")


@contextmanager
def _connected(
    checks: CheckList, stand: Stand, mode: Quantity, search: Callable[[str, Any], list[str]]
) -> Iterator[Servo | None]:
    """Yield the servo, or None if it cannot be opened. Afterwards switch the torque off and close the link."""
    try:
        with connecting(stand.stand.backend):
            servo, _ = open_servo(stand, quantity=mode, watch=_WATCH)
    except DriverError as error:
        checks.failed("connection", f"{error}{_searched(stand, error, search)}")
        yield None
        return
    try:
        checks.info = servo.info
        checks.passed("connection", _identity(servo.info))
        if too_small := limits_below_one_count(stand, servo.info):
            checks.failed("limits", too_small)
        yield None if too_small else servo
    except DriverError as error:
        checks.failed("drive", str(error))
    finally:
        try:
            _torque_off(checks, servo)
        finally:
            servo.close()


def _check_neighbours(checks: CheckList, stand: Stand, servo: Servo) -> bool:
    """Check that no other drive on the bus holds torque. Return whether the drive may be armed. Raises DriverError."""
    refused = refused_neighbours(stand, servo)
    if refused:
        checks.failed("neighbours", "; ".join(refused))
    elif refused is not None:
        checks.passed("neighbours", "no other drive of its kind on the bus holds torque")
    elif stand.stand.backend not in NOTHING_TURNS:
        message = "drives of this kind cannot be asked: before anything moves, make sure that no other one holds torque"
        checks.add("neighbours", Verdict.SKIPPED, message)
    return not refused


def _torque_off(checks: CheckList, servo: Servo) -> None:
    result = confirm_torque_off(servo, alarm=checks.alarm)
    if result.error is not None and not isinstance(result.error, Exception):
        raise result.error


def _searched(stand: Stand, error: DriverError, search: Callable[[str, Any], list[str]]) -> str:
    """Return a sentence about other devices on the link, if the device of the stand file does not answer; "" if there
    are none.
    """
    name = check_backend(stand.stand.backend)
    if not isinstance(error, NoReply | BadReply):
        return ""
    try:
        others = search(name, stand.devices[name])
    except DriverError:
        return ""
    return f". But {'; '.join(others)}: correct the stand file" if others else ""


def _jog_size(limits: LimitsTable, mode: Quantity, amplitude: float | None) -> float:
    """Return the amplitude of the jog, N m or rad at the joint: `amplitude`, or a twentieth of the limit."""
    limit = limits.torque if mode is Quantity.TORQUE else limits.deflection
    return min(limit, limit * _SMALL if amplitude is None else amplitude)


def _move(
    checks: CheckList,
    stand: Stand,
    servo: Servo,
    wanted: tuple[Quantity, float, float],
    stop: StopRequest,
) -> None:
    mode, size, rate = wanted
    try:
        require_watchdog(stand, servo.info)
        require_release(stand, servo.info, mode)
    except WrongUse as error:
        checks.failed("move", str(error))
        return
    if checks.bus is not None:
        rate = reachable(checks.bus, rate)
    outcome, jog = run_jog(stand, servo, mode, stop, amplitude=size, rate=rate, alarm=checks.alarm)
    if outcome.error is not None:
        checks.failed("move", str(outcome.error))
    elif jog is None:
        checks.failed("move", "it was stopped before there were enough readings: run it again")
    else:
        _check_jog(checks, jog, servo.info)


def _check_jog(checks: CheckList, jog: Jog, info: ServoInfo) -> None:
    if not jog.moved(info.position_lsb):
        message = f"the motor moved by {jog.motor:.2g} rad only: raise --amplitude, or look for what blocks it"
        checks.failed("move", message)
        return
    checks.passed("move", f"{jog.deflection:.3g} rad of deflection, {jog.torque * 1e3:.3g} mN m")
    wrong = jog.wrong_signs()
    right = (
        "command, position and torque agree; the first swing was a positive command: if that went the way you call "
        f"negative, set sign = -1 in [{info.backend}]"
    )
    checks.add("signs", Verdict.ERROR if wrong else Verdict.OK, "; ".join(wrong) or right)
    locked, reason = jog.locked()
    checks.add("lock", Verdict.OK if locked else Verdict.ERROR, reason)


def _identity(info: ServoInfo) -> str:
    words = [called(info)]
    if math.isfinite(info.position_lsb):
        words.append(f"one count is {info.position_lsb * 1e3:.3g} mrad")
    if math.isfinite(info.torque_lsb):
        words.append(f"or {info.torque_lsb * 1e3:.3g} mN m")
    if math.isfinite(info.torque_uncertainty):
        words.append(f"torque scale within {info.torque_uncertainty * 100:.0f} %")
    return ", ".join(words)
