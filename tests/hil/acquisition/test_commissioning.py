"""The torque that a run may use on a drive that was commissioned, was not, or did not release its torque."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.ports import emulation
from drivers.servo import Quantity, ServoInfo
from hil.acquisition.commissioning import Commissioning, identity, permitted, require_agreement
from hil.acquisition.excitation import Profile, make
from hil.errors import WrongUse
from hil.stand.file import Stand, load, parse

INFO = ServoInfo(backend="moteus", model="n1", serial="0011", firmware="1.0", watchdog=0.1)


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "hil" / "commissioning"


def stand(*, accepted: bool = False, backend: str = "moteus") -> Stand:
    key = "torque_stays_on_if_host_dies = true\n" if accepted else ""
    limits = "[limits]\ntorque = 0.4\ndeflection = 1.0\nvelocity = 60.0\n"
    return parse(f'[stand]\nbackend = "{backend}"\n{key}{limits}')


def profile(amplitude: float, mode: Quantity = Quantity.TORQUE) -> Profile:
    return make(
        "sine", mode, amplitude=amplitude, default_amplitude=1.0, duration=1.0, band=(2.0, 2.0), rate=100.0, fade=0.1
    )


GOOD = Commissioning(0.0, "1.0", 0.1, releases=True, guardian=True, second_signal=True)


def kept(info: ServoInfo = INFO, days: float = 1.0, outcome: Commissioning = GOOD, opened: Stand | None = None) -> Path:
    return replace(outcome, time=time.time() - days * 86400.0).keep(opened or stand(), info, Quantity.TORQUE)


def limit(opened: Stand, info: ServoInfo = INFO, amplitude: float = 0.1) -> float:
    return permitted(opened, info, profile(amplitude))[0].checked_limits().torque


def test_a_drive_that_was_not_commissioned_gets_half_the_torque_limit_and_a_warning() -> None:
    halved, (warning,) = permitted(stand(), INFO, profile(0.2))
    assert halved.checked_limits().torque == 0.2
    assert "hil doctor" in warning.message
    assert "--commission" in warning.message


def test_a_profile_beyond_that_half_is_refused_with_what_to_do() -> None:
    with pytest.raises(WrongUse, match=r"--commission, .* or use --amplitude 0\.2"):
        permitted(stand(), INFO, profile(0.21))
    assert limit(stand(), amplitude=0.2) == 0.2


def test_positions_are_held_to_the_halved_torque_by_the_limit_alone() -> None:
    halved, _ = permitted(stand(), INFO, profile(0.9, Quantity.POSITION))
    assert halved.checked_limits().torque == 0.2


def test_a_commissioned_drive_gets_the_whole_limit_without_a_word() -> None:
    kept()
    assert permitted(stand(), INFO, profile(0.4)) == (stand(), [])


@pytest.mark.parametrize(
    ("info", "days"),
    [
        (INFO, 30.5),
        (INFO, -2.0),
        (replace(INFO, firmware="1.1"), 1.0),
        (replace(INFO, watchdog=0.5), 1.0),
        (replace(INFO, serial="0012"), 1.0),
    ],
    ids=["too old", "from the future", "other firmware", "other watchdog", "other drive"],
)
def test_an_outcome_that_is_not_of_this_drive_as_it_is_now_does_not_count(info: ServoInfo, days: float) -> None:
    kept(days=days)
    assert limit(stand(), info) == 0.2


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"time": "x"}', '{"releases": 1}', "\x00", "{" * 5000])
def test_a_damaged_file_may_have_said_that_the_drive_keeps_its_torque(text: str) -> None:
    kept().write_text(text)
    with pytest.raises(WrongUse, match="cannot be read"):
        permitted(stand(), INFO, profile(0.1))
    assert limit(stand(accepted=True)) == 0.2


KEEPS = replace(GOOD, releases=False)


@pytest.mark.parametrize("days", [1.0, 31.0, -400.0], ids=["new", "old", "clock set back"])
@pytest.mark.parametrize("changed", [{}, {"watchdog": 0.5}, {"firmware": "1.1"}], ids=["same", "watchdog", "firmware"])
@pytest.mark.parametrize("by_id", [False, True], ids=["serial number", "id alone"])
def test_a_drive_that_keeps_its_torque_is_not_driven_again_whatever_changes(
    days: float, changed: dict[str, float | str], *, by_id: bool
) -> None:
    info = replace(INFO, serial_is_id=by_id)
    kept(info, days, KEEPS)
    info = replace(info, **changed)  # type: ignore[arg-type]  # a number and a text
    with pytest.raises(WrongUse, match="Nothing was driven"):
        permitted(stand(), info, profile(0.1))
    permitted(stand(accepted=True), info, profile(0.1))
    kept(info, outcome=replace(GOOD, guardian=False))  # a test that it passed in part
    with pytest.raises(WrongUse, match="Nothing was driven"):
        permitted(stand(), info, profile(0.1))
    kept(info)
    assert limit(stand(), replace(info, firmware="1.0", watchdog=0.1)) == 0.4


def test_another_user_learns_from_the_stand_file_that_the_drive_keeps_its_torque(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "stand.toml"
    file.write_text(stand().text)
    kept(outcome=KEEPS, opened=load(file))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another"))
    with pytest.raises(WrongUse, match="Nothing was driven"):
        permitted(load(file), INFO, profile(0.1))
    assert limit(load(file), replace(INFO, serial="0012")) == 0.2  # another drive
    kept(opened=load(file))
    assert limit(load(file)) == 0.4


@pytest.mark.parametrize("failed", [{"guardian": False}, {"second_signal": False}])
def test_a_drive_that_our_own_off_paths_do_not_stop_stays_at_half(failed: dict[str, bool]) -> None:
    kept(outcome=replace(GOOD, **failed))  # type: ignore[arg-type]  # truth values
    assert limit(stand()) == 0.2


def test_a_stand_that_can_have_no_guardian_is_commissioned_without_it() -> None:
    kept(outcome=replace(GOOD, guardian=None))
    assert limit(stand()) == 0.4


@pytest.mark.parametrize("backend", ["sim", "replay"])
def test_what_turns_nothing_needs_no_commissioning(backend: str) -> None:
    assert limit(stand(backend=backend), replace(INFO, backend=backend)) == 0.4


def test_a_drive_without_a_serial_number_is_known_by_model_id_and_firmware() -> None:
    by_id = replace(INFO, serial="id 3", serial_is_id=True)
    assert identity(by_id).startswith("moteus n1, id 3, firmware 1.0 (it reports no serial number")
    assert identity(INFO) == "moteus n1, serial number 0011"
    kept(by_id)
    assert limit(stand(), by_id) == 0.4
    assert limit(stand(), replace(by_id, serial="id 4")) == 0.2


@pytest.fixture
def pty(tmp_path: Path) -> Iterator[Path]:
    """A symlink to a pty, with a name as that of a real adapter."""
    ends = os.openpty()
    link = tmp_path / "ttyUSB0"
    link.symlink_to(os.ttyname(ends[1]))
    yield link
    for end in ends:
        os.close(end)


def test_what_was_shown_on_an_emulator_counts_there_only(pty: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    on = parse(stand(backend="dynamixel").text + f'[dynamixel]\nport = "{pty}"\nmodel = "xl330-m288"\n')
    info = ServoInfo("dynamixel", "xl330-m288", "id 1", "52", watchdog=0.1, serial_is_id=True)
    good, asked = replace(GOOD, firmware="52"), list[str]()
    kept(info, outcome=good, opened=on)
    assert limit(on, info) == 0.4
    require_agreement(on, Quantity.TORQUE, "moves", asked.append)
    assert asked == []
    with monkeypatch.context() as later:  # the link leads to a real adapter now
        later.setattr("hil.acquisition.drive_memory.emulation", lambda _table: "")
        assert limit(on, info) == 0.2
        require_agreement(on, Quantity.TORQUE, "moves", asked.append)
        assert len(asked) == 1
        kept(info, outcome=replace(good, releases=False), opened=on)
    kept(info, outcome=good, opened=on)
    monkeypatch.setattr("hil.acquisition.drive_memory.emulation", lambda _table: "")
    with pytest.raises(WrongUse, match="Nothing was driven"):
        permitted(on, info, profile(0.1))


def test_the_device_says_whether_a_link_is_emulated_not_its_name(pty: Path, tmp_path: Path) -> None:
    def kind(port: object, interface: str | None = None) -> str:
        end = {"port": str(port)} if interface is None else {"interface": interface, "channel": str(port)}
        return emulation(SimpleNamespace(**end), tmp_path)

    for made in ("dev/char/1:3/device", "class/net/ttyUSB0/device"):
        (tmp_path / made).mkdir(parents=True)
    assert [kind(pty), kind(pty, "slcan"), kind(f"{pty}@115200", "slcan"), kind(pty, "damiao")] == ["pty"] * 4
    assert [kind("/dev/null"), kind("/dev/zero"), kind("loop://")] == [
        "",
        "virtual port",
        "loop",
    ]  # with a device or not
    assert [kind("ttyUSB0", "socketcan"), kind("can0", "socketcan"), kind("1", "pcan")] == ["", "can0", ""]
    assert [kind("239.0.0.1", "udp_multicast"), kind("0", "virtual")] == ["udp_multicast", "virtual"]
