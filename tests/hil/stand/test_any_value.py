"""Whatever number or text a stand file has: the file is refused in a sentence, or its stand can be built and driven."""

from __future__ import annotations

import json
import math
import random
import struct
import traceback
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, cast

import pytest

from drivers.clock import VirtualClock
from drivers.servo import Command, DriverError, Quantity, Servo, ServoInfo
from hil.acquisition.commissioning import permitted
from hil.acquisition.excitation import make
from hil.acquisition.recorder import Recorder
from hil.acquisition.sink import Memory
from hil.errors import Untrustworthy, WrongUse
from hil.quantities import keys_of
from hil.stand.calibration import CalibrationTable
from hil.stand.devices import BACKENDS, SENSORS, open_backend, restrictions
from hil.stand.file import LimitsTable, Stand, StandTable, parse
from hil.stand.servo import StandServo
from hil.stand.transmission import Transmission, Zero
from hil.stand.winding import WindingTable
from sim_backend.servo import SimServo

from ...drivers import conftest as rigs

REFUSED = (WrongUse, Untrustworthy, DriverError)
CAN = {"interface": "loopback", "channel": "0"}
DEVICES: dict[str, tuple[dict[str, Any], Callable[[], Any] | None]] = {
    "sim": ({}, None),
    "replay": ({"recording": "none.h5"}, None),
    "dynamixel": ({"port": "loopback", "model": "xl330-m288"}, rigs.new_rig),
    "feetech": ({"port": "loopback", "model": "hls3930m"}, rigs.feetech_rig),
    "commander": ({"port": "loopback", "torque_constant": 0.0145, "watchdog": 0.0}, rigs.new_foc),
    "odrive": (CAN | {"torque_constant": 0.04}, rigs.odrive_rig),
    "mit": (CAN | {"model": "dm-j4310"}, rigs.mit_rig),
    "robstride": (CAN | {"model": "rs00"}, rigs.robstride_rig),
    "moteus": (CAN, rigs.moteus_rig),
    "cia402": (CAN | {"profile": "epos4"}, rigs.cia402_rig),
}
DATE = {"date": datetime(2026, 1, 1, tzinfo=UTC)}
COMMON: dict[str, dict[str, Any]] = {
    "stand": {"torque_stays_on_if_host_dies": True},
    "limits": {"torque": 0.03, "deflection": 1.0, "velocity": 40.0},
    "calibration": {},
    "calibration.torque": DATE | {"scale": 1.0, "uncertainty": 0.1, "offset": 0.0, "residual": 0.0, "points": 3},
    "calibration.step": DATE | {"delay": 0.0, "uncertainty": 0.0, "bandwidth": 1.0},
    "calibration.fixture": DATE
    | {"recording": "", "uid": "", "stiffness": 9.0, "stiffness_uncertainty": 0.0}
    | {"damping": 0.0, "damping_uncertainty": 0.0},
    "calibration.zero": DATE | {"zero": 0.0, "uncertainty": 0.0},
}
WINDINGS: tuple[dict[str, Any], ...] = (
    {"continuous_torque": 0.02, "peak_torque": 0.05, "peak_time": 10.0},
    {"torque_constant": 0.0145, "resistance": 8.7, "thermal_resistance": 5.0, "time_constant": 7.0}
    | {"case_thermal_resistance": 20.0, "case_time_constant": 400.0},
)


@cache
def keys(backend: str) -> list[tuple[str, str]]:
    """Return (table, key) of every value that a stand file of this backend may have."""
    kinds: dict[str, Any] = {
        "stand": StandTable,
        "limits": LimitsTable,
        "winding": WindingTable,
        "calibration": CalibrationTable,
    }
    kinds |= {backend: BACKENDS[backend].table_class(), "joint_sensor": SENSORS["loadcell"].table_class()}
    return [found for name, kind in kinds.items() for found in inside(kind, name, ())]


def inside(kind: Any, name: str, place: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    for key in keys_of(kind, place):
        inner = list(inside(kind, name, (*place, key))) if keys_of(kind, (*place, key)) else []
        yield from inner or [(".".join((name, *place)), key)]


def number(drawn: random.Random) -> float:
    """Return a number of the whole of float64, or, so that many files are valid, one of the size of a stand's."""
    anywhere = struct.unpack("<d", drawn.randbytes(8))[0]
    return float(drawn.choice((anywhere, 10.0 ** drawn.uniform(-16.0, 16.0), *(10.0 ** drawn.uniform(-9.0, 1.0),) * 4)))


def value(drawn: random.Random) -> Any:
    kind = drawn.randrange(12)
    if kind < 7:
        return number(drawn) * drawn.choice((1.0, 1.0, 1.0, -1.0, 0.0))
    if kind < 9:
        return drawn.choice((drawn.getrandbits(drawn.choice((4, 8, 16, 63, 64, 1100))), -drawn.getrandbits(40)))
    if kind < 10:
        return drawn.choice((True, False, [], [number(drawn)], datetime.min, datetime.max.replace(tzinfo=UTC)))
    text = "".join(chr(drawn.randrange(0xD800)) if drawn.random() < 0.5 else "m" for _ in range(drawn.randrange(40)))
    return drawn.choice((text, f"{number(drawn)} mN*m", f"{number(drawn)} ms", "\U0010ffff" + text, "." * 300))


def toml(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, datetime):
        return value.isoformat()
    return str(value).lower() if isinstance(value, bool) else repr(value)


def stand_file(drawn: random.Random) -> tuple[str, str]:
    """Return a valid stand file with one or two values changed, and its backend."""
    backend = drawn.choice(tuple(DEVICES))
    tables = {name: dict(table) for name, table in (COMMON | {backend: DEVICES[backend][0]}).items()}
    tables["stand"]["backend"] = backend
    for _ in range(drawn.choice((1, 1, 2))):
        table, key = drawn.choice(keys(backend))
        if table == "winding":
            tables.setdefault(table, dict(WINDINGS[key not in WINDINGS[0]]))
        if table == "joint_sensor":
            tables.setdefault(table, {"kind": "loadcell", "port": "x", "scale": 1.0, "format": "value"})
        tables.setdefault(table, {})[key] = value(drawn)
    lines = [f"[{name}]\n" + "".join(f"{key} = {toml(one)}\n" for key, one in tables[name].items()) for name in tables]
    return "".join(lines), backend


def build(stand: Stand, backend: str) -> None:
    """Build all that a run of `stand` needs, and drive its simulated or emulated servo for a few ticks."""
    stand.calibration_diagnostics(datetime.now(UTC))
    stand.named_files()
    table = stand.devices[backend]
    restrictions(table, stand.stand.torque_source)
    limits = stand.checked_limits()
    profile = make(
        "sine",
        Quantity.TORQUE,
        amplitude=0.1 * limits.torque,
        default_amplitude=limits.torque,
        duration=0.5,
        band=(2.0, 2.0),
        rate=100.0,
        fade=0.1,
    )
    permitted(stand, ServoInfo(backend, "model"), profile)
    new_rig = DEVICES[backend][1]
    rig = None
    servo: Servo
    if backend == "sim":
        servo = cast("Servo", SimServo(stand.simulated(), seed=0, clock=VirtualClock()))
    elif new_rig is None:
        servo = open_backend(backend, table, Quantity.TORQUE)
    else:
        rig = new_rig()
        rig.config = table
        servo = rig.open()
    servo = StandServo(servo, stand.stand.zero, None)
    try:
        Recorder(stand, servo, profile, 100.0, Memory())
        if rig is not None:  # the simulated plant takes its time
            drive(stand, servo)
    finally:
        servo.close()
        assert rig is None or not rig.motor.enabled


def drive(stand: Stand, servo: Servo) -> None:
    transmission, limits = Transmission.of(stand.stand), stand.checked_limits()
    zero = Zero(servo.exchange(Command.rest()).motor_position)
    servo.arm(transmission.motor_limits(limits, zero.motor))
    for share in (0.1, -0.5, 1.0):
        sample = servo.exchange(transmission.commands(Quantity.TORQUE, zero)(share * limits.torque))
        assert not math.isinf(sample.motor_torque)


@pytest.mark.study
@pytest.mark.parametrize(("first", "count"), [(0, 150), (10_000, 8_000)])
def test_a_stand_file_of_any_values_is_refused_or_built(
    first: int, count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    faults: dict[str, str] = {}
    built = 0
    for seed in range(first, first + count):
        text, backend = stand_file(random.Random(seed))  # noqa: S311 - no secret
        try:
            build(parse(text), backend)
            built += 1
        except REFUSED:
            continue
        except Exception as error:  # noqa: BLE001 - a fault in hil
            at = traceback.extract_tb(error.__traceback__)[-1]
            faults.setdefault(f"{type(error).__name__} at {at.filename}:{at.lineno}", f"seed {seed}: {error}\n{text}")
    assert not faults, "\n\n".join(f"{where}\n{what}" for where, what in faults.items())
    assert built > 0.1 * count
