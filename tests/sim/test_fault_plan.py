"""A plan of faults: each happens when it is due, on the simulated servo and in every emulated drive."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import cast

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.servo import (
    BadReply,
    Command,
    DeviceFault,
    DriverError,
    Limits,
    LinkLost,
    NoReply,
    Quantity,
    Sample,
    Servo,
    Status,
)
from sim_backend.fault_plan import DRIVE, HOST, KINDS, LINK, FaultPlan, PlannedFault
from sim_backend.faulty_servo import FaultyServo
from sim_backend.parameters import SimParameters
from sim_backend.servo import SimServo
from sim_backend.wire.drive_faults import DriveFaults
from sim_backend.wire.faults import SerialFault, Unplug, WireFaults, follow


def acting(plan: FaultPlan, frames: int, period: float = 0.01) -> list[int]:
    """The frames on which "drop" acts, at one frame a period."""
    return [number for number in range(1, frames + 1) if plan.acting(("drop",), number * period, number)]


def test_a_fault_happens_at_a_time_a_frame_or_at_random() -> None:
    assert acting(FaultPlan([PlannedFault("drop", at=0.055)]), 20) == [6]
    assert acting(FaultPlan([PlannedFault("drop", at=0.055, count=3)]), 20) == [6, 7, 8]
    assert acting(FaultPlan([PlannedFault("drop", at=0.055, duration=0.03)]), 20) == [6, 7, 8]
    assert acting(FaultPlan([PlannedFault("drop", frame=4, count=2)]), 20) == [4, 5]
    seeds = [acting(FaultPlan([PlannedFault("drop", probability=0.1)], seed), 1000) for seed in (1, 1, 2)]
    assert seeds[0] == seeds[1] != seeds[2]
    assert len(seeds[0]) == pytest.approx(100, abs=40)


def test_a_fault_that_lasts_goes_on_for_good() -> None:
    plan = FaultPlan([PlannedFault("unplug", at=0.055)])
    assert [number for number in range(1, 11) if plan.acting(LINK, number * 0.01, number)] == [6, 7, 8, 9, 10]


def faulty(*faults: PlannedFault, watched: bool = True) -> tuple[FaultyServo, SimServo]:
    """A simulated servo with faults, and the simulated servo inside it."""
    inner = SimServo(SimParameters(), seed=0, clock=VirtualClock(), watched=watched)
    return FaultyServo(cast("Servo", inner), FaultPlan(faults), lambda _: None), inner


def exchanged(servo: FaultyServo, torque: float, ticks: int = 10) -> list[Sample | DriverError]:
    """The outcomes of exchanges, one in 10 ms."""
    seen: list[Sample | DriverError] = []
    for tick in range(ticks):
        servo.clock.sleep_until(0.01 * tick)
        try:
            seen.append(servo.exchange(Command(Quantity.TORQUE, torque)))
        except DriverError as error:
            seen.append(error)
    return seen


def outcomes(kind: str, **settings: float) -> list[Sample | DriverError]:
    """Ten exchanges at rest of the simulated servo, with a fault from the fifth on."""
    return exchanged(faulty(PlannedFault(kind, frame=5, **settings))[0], 0.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "error"),
    [
        ("drop", NoReply),
        ("drop-request", NoReply),
        ("reboot", NoReply),
        ("flip", BadReply),
        ("noise", BadReply),
        ("flood", BadReply),
        ("truncate", BadReply),
    ],
)
def test_a_fault_of_one_frame_costs_one_reply(kind: str, error: type[DriverError]) -> None:
    seen = outcomes(kind)
    assert [number for number, one in enumerate(seen, 1) if isinstance(one, error)] == [5]
    assert sum(isinstance(one, Sample) for one in seen) == 9


@pytest.mark.parametrize(("kind", "error"), [("unplug", LinkLost), ("bus-off", LinkLost), ("error", DeviceFault)])
def test_a_fault_that_lasts_is_raised_by_every_exchange(kind: str, error: type[DriverError]) -> None:
    assert [type(one) for one in outcomes(kind)] == [Sample] * 4 + [error] * 6


def test_old_late_and_wrong_readings_arrive_as_such() -> None:
    assert [bool(cast("Sample", one).status & Status.STALE) for one in outcomes("swap")].index(True) == 4
    late = cast("Sample", outcomes("delay")[4])
    assert isinstance(outcomes("delay", size=0.02)[4], NoReply)
    assert math.isfinite(late.motor_position)
    jumped = [cast("Sample", one).motor_position for one in outcomes("jumping-encoder", size=0.25)]
    assert jumped[4] - jumped[3] == pytest.approx(0.25, abs=1e-6)
    assert cast("Sample", outcomes("over-temperature", size=99.0)[-1]).temperature == 99.0
    noisy = [cast("Sample", one).motor_position for one in outcomes("noisy-encoder")]
    assert len(set(noisy[4:])) == 6


@pytest.mark.parametrize("watched", [True, False])
@pytest.mark.parametrize("kind", ["drop-request", "unplug", "bus-off", "ignored-off"])
def test_a_torque_off_that_does_not_reach_the_drive_is_left_to_its_watchdog(
    limits: Limits, kind: str, watched: bool
) -> None:
    servo, inner = faulty(PlannedFault(kind, at=0.05, duration=9.0), watched=watched)
    servo.arm(limits)
    exchanged(servo, 1e-3, ticks=6)
    with suppress(DriverError):
        servo.disarm()
    servo.close()
    assert inner.true_state().motor_torque > 0.9e-3
    servo.clock.sleep_until(0.2)
    assert (inner.true_state().motor_torque == 0.0) == (not inner.true_state().enabled) == watched


@pytest.mark.parametrize("seed", range(12))
def test_whatever_goes_wrong_the_torque_is_off_a_watchdog_after_closing(limits: Limits, seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinds = sorted({*LINK, *DRIVE} - {"broken-watchdog"})
    servo, inner = faulty(
        *(
            PlannedFault(str(rng.choice(kinds)), at=rng.uniform(0.0, 0.4), duration=rng.choice([0.04, math.nan]))
            for _ in range(3)
        )
    )
    servo.arm(limits)
    exchanged(servo, 1e-3, ticks=40)
    servo.close()
    servo.clock.sleep_until(servo.clock.now() + inner.info.watchdog + 1e-3)
    assert inner.true_state().motor_torque == 0.0
    assert not inner.true_state().enabled


def test_every_kind_can_happen_somewhere_on_a_wire_or_in_the_simulated_servo() -> None:
    serial, can = known(can=False), known(can=True)
    assert serial | can | {"error", "broken-watchdog", "disk-full", "disk-frozen"} == frozenset(KINDS)
    assert {"flip", "noise", "flood"} & can == frozenset()
    assert frozenset(KINDS) == frozenset(LINK) | frozenset(DRIVE) | frozenset(HOST)


class Motor:
    def follow_plan(self, plan: FaultPlan) -> frozenset[str]:
        del plan
        return DriveFaults.KNOWN


def known(*, can: bool) -> frozenset[str]:
    """The kinds that an emulated drive takes."""
    return frozenset(kind for kind in KINDS if taken(kind, can=can))


def taken(kind: str, *, can: bool) -> bool:
    try:
        follow(FaultPlan([PlannedFault(kind, frame=1)]), WireFaults[SerialFault](), [Motor()], 0.0, can=can)
    except ValueError:
        return False
    return True


def test_faults_on_a_wire_change_what_arrives() -> None:
    def arriving(kind: str, **settings: float) -> list[bytes]:
        faults = WireFaults[SerialFault]()
        faults.follow(FaultPlan([PlannedFault(kind, frame=2, **settings)]), 0.0)  # type: ignore[arg-type]
        out: list[tuple[float, bytes]] = []
        for number, data in enumerate((b"one.", b"two.", b"six.")):
            if not isinstance(faults.interrupts_reply(0.01 * number), Unplug):
                out += faults.arriving(data, 0.01 * number)
        return [data for _, data in sorted(out)]

    assert arriving("drop") == [b"one.", b"six."]
    assert arriving("duplicate") == [b"one.", b"two.", b"two.", b"six."]
    assert arriving("swap") == [b"one.", b"six.", b"two."]
    assert arriving("delay", size=0.02) == [b"one.", b"six.", b"two."]
    assert arriving("truncate", size=1) == [b"one.", b"t", b"six."]
    assert arriving("unplug") == [b"one."]
    assert [len(data) for data in arriving("flood", size=1000)] == [4, 1004, 4]
    flipped = arriving("flip")[1]
    assert sum((one ^ other).bit_count() for one, other in zip(flipped, b"two.", strict=True)) == 1
