"""Open the servo of a stand, with its joint sensor and its zero."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from pydantic import TypeAdapter, ValidationError

from drivers.clock import MonotonicClock
from drivers.neighbours import HasNeighbours, JoinsHand, SeesNeighbours
from drivers.servo import Quantity, Servo, ServoInfo
from hil.errors import WrongUse
from hil.guardian.servo import GuardedServo, Watch, guarded
from hil.stand.devices import BACKENDS, check_backend, open_backend, open_sensor
from hil.stand.file import Stand
from hil.stand.servo import StandServo
from hil.stand.transmission import Transmission
from hil.standard_files import open_standard_files


def open_servo(
    stand: Stand,
    *,
    quantity: Quantity = Quantity.TORQUE,
    seed: int = 0,
    realtime: bool = False,
    watch: Watch | None = None,
    watched: bool = True,
) -> tuple[Servo, Mapping[str, float]]:
    """Open the stand's servo; the caller closes it. Return the servo, and the true parameters if it is simulated ({}
    otherwise).

    The returned servo includes the stand's joint sensor and zero. quantity: what the set-points command, which selects
    the mode of some drives. seed: of all random numbers in a simulated servo. realtime: run a simulated servo in wall
    time. watch: when a guardian switches the torque off; None: without a guardian. watched: whether the watchdog of a
    simulated drive works. Raises WrongUse, DriverError.
    """
    open_standard_files()
    name = check_backend(stand.stand.backend)
    truth: Mapping[str, float] = {}
    if name == "sim":
        from drivers.clock import VirtualClock
        from sim_backend.servo import SimServo

        clock = MonotonicClock() if realtime else VirtualClock()
        simulated = SimServo(
            stand.simulated(),
            seed=seed,
            clock=clock,
            watched=watched,
            neighbours=stand.simulated_neighbours(),
        )
        servo, truth = cast("Servo", simulated), simulated.truth()
    else:
        servo = open_backend(name, _table_of(stand, name), quantity)
        if isinstance(servo, JoinsHand):
            servo.join_hand(stand.stand.hand_ids)
        servo = servo if watch is None else guarded(servo, watch)
    if stand.sensor is None and not stand.stand.zero:
        return servo, truth
    try:
        sensor = None if stand.sensor is None else open_sensor(*stand.sensor, servo.clock)
    except BaseException:
        servo.close()
        raise
    return StandServo(servo, stand.stand.zero, sensor), truth


def innermost(servo: Servo) -> Servo:
    """Return the drive's own adapter, without what the stand and the guardian put around it."""
    while isinstance(servo, StandServo | GuardedServo):
        servo = servo.inner
    return servo


def slower_when_armed(servo: Servo) -> tuple[float, float]:
    """Return by how much, s, an exchange takes longer once the servo is armed, on average and at most, as far as it is
    known. Raises DriverError.
    """
    inner = innermost(servo)
    return inner.slower() if isinstance(inner, SeesNeighbours) else (0.0, 0.0)


def refused_neighbours(stand: Stand, servo: Servo) -> list[str] | None:
    """Return a sentence for each other drive on the servo's bus that holds torque, except those in `holding_ids`, and
    one for a hand whose drives in `holding_ids` cannot be switched off with the servo.

    None: drives like this one cannot be asked. Takes about a second; nothing is written to a drive. Raises DriverError.
    """
    inner = innermost(servo)
    held = sorted({*stand.stand.holding_ids}.intersection(stand.stand.hand_ids.values()))
    if held and not isinstance(inner, JoinsHand):
        return [
            f"the drives {held} of this hand may hold torque, and hil cannot switch such drives off together with the "
            "one that it drives: lock their joints instead, and remove holding_ids from [stand]"
        ]
    found = inner.neighbours() if isinstance(inner, HasNeighbours) else None
    joints = {ident: f", joint {joint}" for joint, ident in stand.stand.hand_ids.items()}
    if found is None:
        return None
    ids = sorted({*stand.stand.holding_ids, *(one.ident for one in found)})
    return [
        f"drive {one.ident} on the same bus ({one.kind}{joints.get(one.ident, '')}) may hold torque: {one.state}. What "
        f"it does to the joint would be taken for Kc and Bc, and it may move. To release it, {one.release}, or cut its "
        f"power; if it belongs to the stand, such as a motor that locks the joint, set holding_ids = {ids} in [stand]"
        for one in found
        if one.ident not in stand.stand.holding_ids
    ]


def require_quiet_neighbours(stand: Stand, servo: Servo) -> None:
    """Raise WrongUse if another drive on the servo's bus holds torque. Raises DriverError if the link fails."""
    refused = refused_neighbours(stand, servo)
    if refused:
        raise WrongUse(f"{'; '.join(refused)}. Nothing was driven")


def limits_below_one_count(stand: Stand, info: ServoInfo) -> str:
    """Return a sentence about the limits that are smaller than one count of the drive; "" if there are none."""
    limits, way = stand.checked_limits(), Transmission.of(stand.stand)
    counts = (
        ("torque", "N m", limits.torque, way.torque(info.torque_lsb)),
        ("deflection", "rad", limits.deflection, way.rate(info.position_lsb)),
        ("velocity", "rad/s", limits.velocity, way.rate(info.velocity_lsb)),
    )
    small = [
        f"limits.{name} {limit:.3g} {unit} (one count: {lsb:.3g})" for name, unit, limit, lsb in counts if limit < lsb
    ]
    if not small:
        return ""
    return (
        f"{info.model} {info.serial} cannot keep to a limit below one of its counts at the joint: {', '.join(small)}. "
        "Kc and Bc would be made of its rounding: raise this limit, or take a smaller motor or a higher gear ratio"
    )


def require_watchdog(stand: Stand, info: ServoInfo) -> None:
    """Raise WrongUse if the drive keeps its torque when this computer stops, unless the stand file accepts that."""
    if info.watchdog > 0.0 or stand.stand.torque_stays_on_if_host_dies:
        return
    remedy = f"{info.watchdog_remedy}; or " if info.watchdog_remedy else ""
    raise WrongUse(
        f"{info.backend} {info.model} has no watchdog that this stand file sets: if this computer stops, the motor "
        f"keeps its last torque against the locked joint until its power is cut. Nothing was driven: {remedy}accept "
        "this with torque_stays_on_if_host_dies = true in [stand], and keep a switch for its power at hand"
    )


def _table_of(stand: Stand, name: str) -> Any:
    """Return the table of the backend `name`. Raises WrongUse, with the keys that the table needs, if the file has no
    such table.
    """
    if name in stand.devices:
        return stand.devices[name]
    try:
        return TypeAdapter(BACKENDS[name].table_class()).validate_python({})
    except ValidationError as error:
        keys = ", ".join(str(item["loc"][0]) for item in error.errors())
        raise WrongUse(f"the stand file has no [{name}]: add it with at least {keys}") from None
