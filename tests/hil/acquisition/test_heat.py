"""The heat budget: refused before the start, ended in time without a sensor, and remembered between two runs."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.servo import Quantity, Sample, ServoInfo
from hil.acquisition import excitation
from hil.acquisition.drive_memory import StoredFacts
from hil.acquisition.excitation import Profile
from hil.acquisition.heat import HeatMemory, TooHot, WindingHeat, heat_budget
from hil.acquisition.limits import AtJoint, LimitReached
from hil.acquisition.recorder import Recorder
from hil.acquisition.sink import Memory
from hil.errors import WrongUse
from hil.stand.file import Stand, parse
from hil.stand.winding import Temperatures, WindingModel

from ..conftest import SpringServo

INFO = ServoInfo("dynamixel", "xl330/m288", serial="id 1")
NOW = 1.8e9  # s since 1970
WINDING = "[winding]\ncontinuous_torque = 0.005\npeak_torque = 0.02\npeak_time = 10.0\n"
"""At the motor shaft: 10 s of 20 mN m heat it to its limit, which is 55 degC above the air."""
_TAU = -10.0 / math.log1p(-1.0 / 16.0)  # s


@pytest.fixture(autouse=True)
def state_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("hil.acquisition.heat.time.time", lambda: NOW)
    monkeypatch.setattr("hil.acquisition.heat.since_boot", lambda: ("", 0.0))  # the time of day alone
    return tmp_path / "hil" / "heat"


def stand(backend: str = "dynamixel") -> Stand:
    return parse(
        f'[stand]\nbackend = "{backend}"\ngear_ratio = 4.0\ntorque_source = "joint"\n'
        "[limits]\ntorque = 0.1\ndeflection = 1.0\nvelocity = 50.0\ntemperature = 80.0\n" + WINDING
    )


def profile(amplitude: float, duration: float, mode: Quantity = Quantity.TORQUE) -> Profile:
    return excitation.make(
        "sine",
        mode,
        amplitude=amplitude,
        default_amplitude=1.0,
        duration=duration,
        band=(2.0, 2.0),
        rate=100.0,
        fade=0.1,
    )


def budget(amplitude: float, duration: float, backend: str = "dynamixel") -> WindingHeat:
    made = heat_budget(stand(backend), INFO, profile(amplitude, duration))
    assert made is not None
    return made


def at_rest(temperature: float = math.nan) -> list[Sample]:
    return [Sample(0.0, 0.0, temperature=temperature)]


@pytest.mark.study
@pytest.mark.parametrize("amplitude", [0.06, 0.12])
def test_the_duration_and_the_amplitude_that_are_proposed_fit_and_little_more_does_not(amplitude: float) -> None:
    with pytest.raises(LimitReached) as refused:
        budget(amplitude, 300.0, "sim").start(at_rest(), [])
    said = re.findall(r"add --(duration|amplitude) ([0-9.]+)", str(refused.value))
    assert {name for name, _ in said} == {"duration", "amplitude"}
    for name, text in said:
        for factor, fits in ((1.0, True), (1.2, False)):
            size = {"amplitude": amplitude, "duration": 300.0} | {name: factor * float(text)}
            with contextlib.nullcontext() if fits else pytest.raises(LimitReached):
                budget(**size, backend="sim").start(at_rest(), [])


def test_a_run_that_would_overheat_the_winding_is_refused_with_the_duration_that_would_not() -> None:
    # a sine of 16 mN m has the heat of 11.3 mN m: 75 degC after 15.4 s, by the closed form of one time constant
    after = -_TAU * math.log1p(-(50.0 / 55.0) * 2.0 * (0.005 / 0.016) ** 2)
    with pytest.raises(LimitReached, match=r"would reach 75 degC after .* --duration") as refused:
        budget(4 * 0.016, 60.0).start(at_rest(), [])
    said = float(str(refused.value).partition("after ")[2].split()[0])
    assert said == pytest.approx(after, abs=0.3)
    budget(4 * 0.016, said - 1.0).start(at_rest(), [])


def test_a_refused_run_says_how_long_the_motor_must_rest_and_may_begin_then(monkeypatch: pytest.MonkeyPatch) -> None:
    HeatMemory(stand(), INFO).keep(Temperatures(74.0, 25.0), NOW)
    with pytest.raises(TooHot, match=r"let it cool down for \d+ s") as refused:
        budget(4 * 0.016, 10.0).start(at_rest(), [])
    rest = refused.value.rest
    assert rest > 10.0
    monkeypatch.setattr("hil.acquisition.heat.time.time", lambda: NOW + rest - 2.0)
    with pytest.raises(TooHot):
        budget(4 * 0.016, 10.0).start(at_rest(), [])
    monkeypatch.setattr("hil.acquisition.heat.time.time", lambda: NOW + rest)
    budget(4 * 0.016, 10.0).start(at_rest(), [])


def test_a_run_that_is_too_much_for_a_cold_motor_has_no_rest_that_is_enough() -> None:
    with pytest.raises(TooHot, match="too much for a cold motor") as refused:
        budget(4 * 0.016, 60.0).start(at_rest(), [])
    assert math.isinf(refused.value.rest)


def test_a_run_within_the_budget_begins_and_ends_as_predicted(state_folder: Path) -> None:
    made = budget(4 * 0.016, 10.0)
    made.start(at_rest(), [])
    predicted = json.loads(next(state_folder.iterdir()).read_text())
    for tick in range(1, 1001):
        torque = 0.016 * math.sin(2.0 * math.pi * 2.0 * tick * 0.01)
        made.check(Sample(tick * 0.01, tick * 0.01, motor_torque=torque), AtJoint())
    assert made.state.winding == pytest.approx(predicted["winding_degC"], abs=0.3)
    assert predicted["time"] == pytest.approx(NOW + 10.0)
    made.keep()
    kept = json.loads(next(state_folder.iterdir()).read_text())
    assert kept["winding_degC"] == pytest.approx(made.state.winding)
    assert kept["time"] == NOW


def test_more_torque_than_planned_ends_the_run_although_the_sensor_shows_a_cool_winding() -> None:
    made = budget(4 * 0.001, 100.0)
    made.start(at_rest(temperature=25.0), [])
    after = -_TAU * math.log1p(-50.0 / 55.0 / 16.0)  # the closed form
    t = 0.0
    while t < after - 0.05:
        t += 0.01
        made.check(Sample(t, t, motor_torque=-0.02, temperature=25.0), AtJoint())
    with pytest.raises(LimitReached, match="estimated at 75 degC; its limit is 80"):
        made.check(Sample(t + 0.1, t + 0.1, motor_torque=-0.02, temperature=25.0), AtJoint())


def test_a_torque_that_is_not_measured_counts_as_that_of_the_joint_or_as_the_limit() -> None:
    hot = {}
    for name, at_joint in (("joint", AtJoint(torque=0.04)), ("none", AtJoint())):
        made = budget(4 * 0.001, 100.0, "sim")
        made.start(at_rest(), [])
        made.check(Sample(1.0, 1.0), at_joint)
        hot[name] = made.state.winding - 25.0
    assert hot["none"] / hot["joint"] == pytest.approx((0.1 / 0.04) ** 2, rel=1e-6)


def test_a_gap_in_the_replies_heats_for_as_long_as_it_lasted() -> None:
    dense, gap = budget(0.004, 100.0, "sim"), budget(0.004, 100.0, "sim")
    for made in (dense, gap):
        made.start(at_rest(), [])
    for tick in range(1, 201):
        dense.check(Sample(tick * 0.01, 0.0, motor_torque=0.01), AtJoint())
    gap.check(Sample(2.0, 0.0, motor_torque=0.01), AtJoint())
    assert gap.state.winding == pytest.approx(dense.state.winding, abs=1e-6)


def test_a_reported_temperature_above_the_estimate_counts() -> None:
    with pytest.raises(LimitReached, match="It is at 72 degC now"):
        budget(4 * 0.012, 30.0).start(at_rest(temperature=72.0), [])


def test_the_next_run_begins_where_the_last_one_ended_and_cools_with_the_time_of_day(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    HeatMemory(stand(), INFO).keep(Temperatures(70.0, 30.0), NOW)
    model = stand().winding
    assert model is not None
    made = model.model(80.0)
    for rested in (0.0, 60.0, 1e6):
        monkeypatch.setattr("hil.acquisition.heat.time.time", lambda rested=rested: NOW + rested)
        run = budget(0.004, 1.0)
        HeatMemory(stand(), INFO).keep(Temperatures(70.0, 30.0), NOW)
        run.start(at_rest(), [])
        assert run.state == pytest.approx(made.after(Temperatures(70.0, 30.0), 0.0, rested))


def test_a_clock_that_was_set_back_cools_nothing() -> None:
    HeatMemory(stand(), INFO).keep(Temperatures(70.0, 30.0), NOW + 1e6)
    assert HeatMemory(stand(), INFO).load(_model(), NOW) == (70.0, 30.0)


@pytest.mark.parametrize(("boot", "rested"), [("this", 60.0), ("another", 1e6)])
def test_a_clock_that_was_set_forward_since_the_computer_started_cools_nothing_more(
    monkeypatch: pytest.MonkeyPatch, boot: str, rested: float
) -> None:
    monkeypatch.setattr("hil.acquisition.heat.since_boot", lambda: ("this", 500.0))
    HeatMemory(stand(), INFO).keep(Temperatures(70.0, 30.0), NOW)
    monkeypatch.setattr("hil.acquisition.heat.since_boot", lambda: (boot, 560.0))
    model = _model()
    assert HeatMemory(stand(), INFO).load(model, NOW + 1e6) == model.after(Temperatures(70.0, 30.0), 0.0, rested)


def _model() -> WindingModel:
    table = stand().winding
    assert table is not None
    return table.model(80.0)


def test_each_drive_has_a_memory_of_its_own_and_the_simulated_one_none(state_folder: Path) -> None:
    HeatMemory(stand(), INFO).keep(Temperatures(70.0, 30.0), NOW)
    assert HeatMemory(stand(), ServoInfo("dynamixel", "xl330/m288", serial="id 2")).load(_model(), NOW) == _model().cold
    budget(0.004, 1.0, "sim").start(at_rest(), [])
    assert [path.name for path in state_folder.iterdir()] == ["dynamixel_xl330_m288_id_1.json"]


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"time": 0, "winding_degC": NaN, "case_degC": 1}', "x" * 5000])
def test_a_memory_that_cannot_be_read_is_not_taken_for_a_cold_motor(state_folder: Path, text: str) -> None:
    HeatMemory(stand(), INFO).keep(Temperatures(70.0, 30.0), NOW)
    next(state_folder.iterdir()).write_text(text)
    with pytest.raises(WrongUse, match="let the motor cool down, then delete the file"):
        HeatMemory(stand(), INFO).load(_model(), NOW)


def test_a_memory_that_cannot_be_written_refuses_the_run_before_it_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with pytest.raises(WrongUse, match="XDG_STATE_HOME"):
        budget(0.004, 1.0).start(at_rest(), [])


def test_a_memory_that_cannot_be_looked_for_is_not_taken_for_a_cold_motor(state_folder: Path) -> None:
    state_folder.mkdir(parents=True)
    with pytest.raises(WrongUse, match="File name too long"):
        HeatMemory(stand(), replace(INFO, serial="1" * 300)).load(_model(), NOW)


def test_a_memory_that_could_not_be_kept_leaves_the_one_before_and_nothing_else(
    state_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    HeatMemory(stand(), INFO).keep(Temperatures(70.0, 30.0), NOW)
    monkeypatch.setattr("hil.recording.output.take_name", full)
    with pytest.raises(WrongUse, match="No space left on device"):
        HeatMemory(stand(), INFO).keep(Temperatures(25.0, 25.0), NOW)
    assert HeatMemory(stand(), INFO).load(_model(), NOW) == Temperatures(70.0, 30.0)
    assert len(list(state_folder.iterdir())) == 1


@pytest.mark.parametrize("home", [None, "here"], ids=["unknown user", "relative"])
def test_no_memory_depends_on_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, home: str | None
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "state")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert StoredFacts.of_drive("heat", stand(), INFO).path.is_relative_to(tmp_path / ".local" / "state")
    if home is None:
        monkeypatch.delenv("HOME")
        monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)
    else:
        monkeypatch.setenv("HOME", home)
    with pytest.raises(WrongUse, match="set XDG_STATE_HOME"):
        HeatMemory(stand(), INFO)


def test_positions_are_not_predicted_and_a_stand_without_the_table_has_no_budget() -> None:
    made = heat_budget(stand(), INFO, profile(0.5, 1000.0, Quantity.POSITION))
    assert made is not None
    made.start(at_rest(), [])
    assert heat_budget(parse(stand().text.partition("[winding]")[0]), INFO, profile(0.01, 1.0)) is None


def test_a_recorder_refuses_before_it_arms_and_remembers_after_it(state_folder: Path) -> None:
    from hil.acquisition.interrupt import StopRequest

    servo = SpringServo()
    outcome = Recorder(stand(), servo, profile(4 * 0.016, 60.0), 100.0, Memory()).run(StopRequest())
    assert isinstance(outcome.error, LimitReached)
    assert servo.driven == []
    servo = SpringServo(info=INFO)
    servo.info = ServoInfo("dynamixel", "spring", watchdog=0.1)
    outcome = Recorder(stand(), servo, profile(4 * 0.012, 5.0), 100.0, Memory()).run(StopRequest())
    assert outcome.error is None
    kept = json.loads((state_folder / "dynamixel_spring_.json").read_text())
    assert kept["winding_degC"] > 28.0
