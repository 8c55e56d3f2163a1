"""The alarm of every adapter whose drive answers no more, in virtual time."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import pytest

from drivers.servo import Command, DriverError
from drivers.torque_off import confirm_torque_off
from sim_backend.fault_plan import FaultPlan, PlannedFault
from sim_backend.wire.faults import follow

from ..loopback import CanLoopback
from .conftest import RIGS, VARIANTS

FAMILIES = sorted(RIGS.keys() - VARIANTS - {"dynamixel mx"})
SLOW = {"reply_timeout": 0.5, "watchdog": 1.1}


class Heard:
    """The servo of a rig whose drive falls silent, and what a person reads: (s since the first request, text)."""

    def __init__(self, name: str, settings: dict[str, float]) -> None:
        make, self.limits = RIGS[name]
        self.rig = make()
        known = {key: value for key, value in settings.items() if hasattr(self.rig.config, key)}
        self.servo: Any = self.rig.open(**({} if name == "moteus" and not settings["watchdog"] else known))
        self.alarms: list[tuple[float, str]] = []
        self._first: list[float] = []
        self._request, self.servo._gate._torque_off = self.servo._gate._torque_off, self._noted

    def _noted(self, number: int) -> None:
        self._first.append(self.rig.clock.now())
        self._request(number)

    def silence(self, seconds: float) -> None:
        plan = FaultPlan([PlannedFault("drop-request", at=self.rig.clock.now(), duration=seconds)])
        follow(plan, self.rig.faults, [self.rig.motor], 0.0, can=isinstance(self.rig.port, CanLoopback))

    def confirm(self) -> Any:
        return confirm_torque_off(
            self.servo, alarm=lambda text: self.alarms.append((self.rig.clock.now() - self._first[0], text))
        )


@pytest.mark.parametrize("arming", [False, True], ids=["running", "arming"])
@pytest.mark.parametrize("settings", [SLOW, {"watchdog": 0.0}], ids=["slow", "no watchdog"])
@pytest.mark.parametrize("name", FAMILIES)
def test_the_alarm_comes_within_1_s_of_the_first_torque_off_that_is_not_confirmed(
    name: str, settings: dict[str, float], arming: bool
) -> None:
    heard = Heard(name, settings)
    if not arming:
        heard.servo.arm(heard.limits)
    heard.silence(1e6)
    with suppress(DriverError):
        heard.servo.arm(heard.limits) if arming else heard.servo.exchange(Command.rest())
    if heard.confirm().confirmed:  # an idle ODrive says so in its next heartbeat
        assert (arming, heard.rig.motor.enabled, heard.alarms) == (True, False, [])
        return
    ((after, text),) = heard.alarms
    assert text.startswith("CUT THE POWER")
    assert after < 1.0


@pytest.mark.parametrize("name", FAMILIES)
def test_a_torque_off_that_is_confirmed_after_the_alarm_is_said(name: str) -> None:
    heard = Heard(name, {"watchdog": 0.0})
    heard.servo.arm(heard.limits)
    heard.silence(2.0)
    assert heard.confirm().confirmed
    (_, alarm), (after, text) = heard.alarms
    assert alarm.startswith("CUT THE POWER")
    assert "the torque is off" in text
    assert 2.0 <= after < 3.0
    assert not heard.rig.motor.enabled
