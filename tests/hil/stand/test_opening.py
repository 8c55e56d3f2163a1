"""A drive that keeps its torque when this computer stops is driven only where the stand file accepts that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.servo import ServoInfo
from hil.acquisition import run as run_module
from hil.errors import WrongUse
from hil.stand.file import parse
from hil.stand.opening import require_watchdog

from ...drivers.conftest import (
    cia402_rig,
    mit_rig,
    moteus_rig,
    new_foc,
    new_rig,
    nothing_is_left_behind,
    odrive_rig,
    robstride_rig,
)
from ..conftest import Hil, SpringServo

__all__ = ["nothing_is_left_behind"]

STAND = """
[stand]
backend = "sim"
gear_ratio = 4.0
torque_source = "joint"
torque_stays_on_if_host_dies = {accepted}
[limits]
torque = 0.1
deflection = 0.06
velocity = 50.0
"""


@pytest.mark.parametrize(
    ("rig", "changes", "stops", "remedy"),
    [
        (new_rig, {}, True, ""),
        (new_rig, {"watchdog": 0.0}, False, "set dynamixel.watchdog = 0.1"),
        (lambda: new_rig("mx-64"), {}, False, "accept this with"),
        (lambda: odrive_rig("0.5.6"), {}, False, "accept this with"),
        (lambda: odrive_rig("0.6.10"), {}, False, "odrive.endpoints"),
        (lambda: mit_rig("ak80-9"), {}, False, "accept this with"),
        (lambda: mit_rig("dm-j4310"), {}, True, ""),
        (lambda: mit_rig("dm-j4310"), {"watchdog": 0.0}, False, "set mit.watchdog = 0.1"),
        (robstride_rig, {}, True, ""),
        (robstride_rig, {"watchdog": 0.0}, False, "set robstride.watchdog = 0.1"),
        (moteus_rig, {}, True, ""),
        (cia402_rig, {}, True, ""),
        (cia402_rig, {"watchdog": 0.0}, False, "set cia402.watchdog = 0.1"),
        (new_foc, {"watchdog": 0.1}, True, ""),
        (new_foc, {"watchdog": 0.0}, False, "into the board's program"),
    ],
)
def test_a_drive_that_does_not_stop_by_itself_is_refused_with_the_remedy_unless_it_is_accepted(
    rig: Callable[[], Any], changes: dict[str, Any], stops: bool, remedy: str
) -> None:
    servo = rig().open(**changes)
    info: ServoInfo = servo.info
    servo.close()
    assert (info.watchdog > 0.0) == stops
    require_watchdog(parse(STAND.format(accepted="true")), info)
    if stops:
        require_watchdog(parse(STAND.format(accepted="false")), info)
        return
    with pytest.raises(WrongUse, match=r"keeps its last torque") as refusal:
        require_watchdog(parse(STAND.format(accepted="false")), info)
    assert remedy in str(refusal.value)
    assert "torque_stays_on_if_host_dies = true in [stand]" in str(refusal.value)


@pytest.fixture
def careless(monkeypatch: pytest.MonkeyPatch) -> SpringServo:
    """A servo without a watchdog, which every stand opens."""
    servo = SpringServo()
    servo.info = replace(servo.info, watchdog=0.0)
    monkeypatch.setattr(run_module, "open_servo", lambda *_, **__: (servo, {}))
    return servo


@pytest.mark.parametrize("accepted", [False, True])
def test_hil_record_never_arms_a_drive_without_a_watchdog_unasked(
    hil: Hil, tmp_path: Path, careless: SpringServo, accepted: bool
) -> None:
    (tmp_path / "stand.toml").write_text(STAND.format(accepted=str(accepted).lower()))
    ended = hil("record", "--stand", "stand.toml", "--duration", "1", "--rate", "100", "--band", "1:2", "-o", "a.h5")
    assert ended.status == (0 if accepted else 2), ended.err
    assert (careless.limits is not None) == accepted
    assert (tmp_path / "a.h5").exists() == accepted
    assert ("torque_stays_on_if_host_dies" in ended.err) != accepted
