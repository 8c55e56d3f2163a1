"""docs/extending.md: each of its worked examples runs as it stands on the page."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.servo import Command, DriverError, Limits, Quantity, UnsafeCommand
from ga.evolution.evolution import PRESETS
from ga.model import terms
from ga.model.coupling import parse
from hil.acquisition import excitation
from hil.cli.app import run
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.recording.reader import Recording
from hil.stand.devices import BACKENDS, Device

from ..loopback import SerialLoopback

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")
LIMITS = Limits(torque=0.01, velocity=50.0, temperature=80.0, position=(-3.0, 3.0))
STAND = """
[stand]
torque_stays_on_if_host_dies = true
backend = "lineboard"
motor_inertia = 2.0e-7
torque_source = "motor"
[limits]
torque = 0.01
deflection = 1.0
velocity = 50.0
[lineboard]
port = "loopback"
"""


def block(name: str) -> str:
    """The code under the mark `name` of the page."""
    found = re.search(rf"<!-- {name} -->\n```\w+\n(.+?)```", PAGE, re.DOTALL)
    assert found is not None, name
    return found[1]


class LineBoard:
    """The other end of the wire: a spring of 0.02 N m/rad that follows at once. torque: N m, None while it is off."""

    unplugged = False

    def __init__(self) -> None:
        self.torque: float | None = 0.004  # left on by an earlier program
        self.received: list[str] = []
        self.refuses_off = False

    def advance(self, now: float) -> None:
        """Nothing moves by itself."""

    def due(self) -> float:
        return float("inf")

    def receive(self, data: bytes, now: float, baudrate: int | None = None) -> Sequence[tuple[float, bytes]]:
        del baudrate
        return [(now + 1e-3, self._answer(line)) for line in data.decode().splitlines()]

    def _answer(self, line: str) -> bytes:
        self.received.append(line)
        if line == "X":
            self.torque = self.torque if self.refuses_off else None
            return b"busy\n" if self.refuses_off else b"off\n"
        if line != "S":
            self.torque = float(line.removeprefix("T "))
        torque = self.torque or 0.0
        return f"{torque / 0.02:.6f} 0.0 {torque:.6f}\n".encode()


@pytest.fixture
def lineboard(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The page's drive as a module that stands in the table of drives."""
    module = ModuleType("lineboard")
    monkeypatch.setitem(sys.modules, "lineboard", module)
    exec(compile(block("drive: config") + block("drive: servo"), "docs/extending.md", "exec"), vars(module))  # noqa: S102
    line = Device("a board that speaks lines", "lineboard:LineBoardConfig", "lineboard:LineBoardServo")
    for place in ("hil.stand.devices.BACKENDS", "hil.stand.file.BACKENDS", "hil.stand.opening.BACKENDS"):
        monkeypatch.setattr(place, {**BACKENDS, "lineboard": line}, raising=False)
    return module


def opened(lineboard: ModuleType, board: LineBoard) -> Any:
    clock = VirtualClock()
    return lineboard.LineBoardServo(
        lineboard.LineBoardConfig("loopback"), clock=clock, port=SerialLoopback(board, clock)
    )


def test_the_drive_of_the_page_turns_off_what_an_earlier_program_left_on(lineboard: ModuleType) -> None:
    board = LineBoard()
    opened(lineboard, board)
    assert board.received == ["X"]
    assert board.torque is None


def test_the_drive_of_the_page_sends_no_more_than_its_limits_and_nothing_that_is_not_a_number(
    lineboard: ModuleType,
) -> None:
    board = LineBoard()
    servo = opened(lineboard, board)
    servo.arm(LIMITS)
    servo.exchange(Command(Quantity.TORQUE, 5.0))
    assert board.torque == 0.01
    with pytest.raises(UnsafeCommand):
        servo.exchange(Command(Quantity.TORQUE, float("nan")))
    servo.close()
    assert board.torque is None


def test_the_drive_of_the_page_says_when_torque_off_is_not_confirmed(lineboard: ModuleType) -> None:
    board = LineBoard()
    servo = opened(lineboard, board)
    servo.arm(LIMITS)
    board.refuses_off = True
    with pytest.raises(DriverError, match="not confirmed"):
        servo.disarm()


def test_the_drive_of_the_page_is_recorded_from_its_stand_file(
    lineboard: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    board, clock = LineBoard(), VirtualClock()
    made = lineboard.LineBoardServo
    monkeypatch.setattr(
        lineboard, "LineBoardServo", lambda config: made(config, clock=clock, port=SerialLoopback(board, clock))
    )
    (tmp_path / "stand.toml").write_text(STAND, encoding="utf-8")
    words = ["record", "--stand", str(tmp_path / "stand.toml"), "--profile", "sine", "--band", "1", "--duration", "4"]
    assert run([*words, "--rate", "100", "-o", str(tmp_path / "a.h5")]) == 0
    assert board.torque is None
    with Recording(tmp_path / "a.h5") as recording:
        torque, angle = recording.channel("motor_torque"), recording.channel("dtheta")
    assert len(torque) == 401
    assert angle == pytest.approx(torque / 0.02, abs=1e-5)


@pytest.mark.study
def test_the_excitation_of_the_page_is_recorded_and_identified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: dict[str, Any] = {}
    exec(compile(block("excitation"), "docs/extending.md", "exec"), made)  # noqa: S102
    monkeypatch.setattr(excitation, "EXCITATIONS", {**excitation.EXCITATIONS, "stepped": made["STEPPED_SINE"]})
    path = tmp_path / "a.h5"
    assert (
        run(
            ["record", "--backend", "sim", "--profile", "stepped", "--duration", "12", "--rate", "250", "-o", str(path)]
        )
        == 0
    )
    identified = identify(
        [path], parse("linear"), Search("default", PRESETS["default"], trials=2, seed=0, workers=1, bounds={})
    )
    assert identified["Kc"].value == pytest.approx(0.01775, rel=0.02)


def test_the_excitation_of_the_page_never_jumps() -> None:
    made: dict[str, Any] = {}
    exec(compile(block("excitation"), "docs/extending.md", "exec"), made)  # noqa: S102
    time = np.linspace(0.0, 12.0, 120_001)
    values = made["stepped_sine"]((0.5, 10.0), 12.0, 0)(time)
    assert np.abs(np.diff(values)).max() <= 2.0 * np.pi * 10.0 * 1.0001e-4
    assert np.abs(values).max() <= 1.0


@pytest.fixture
def with_seventh(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's term as one more record of the table, wherever that was imported."""
    made: dict[str, Any] = {}
    exec(compile(block("term"), "docs/extending.md", "exec"), made)  # noqa: S102
    longer = {
        "TERMS": (terms.TERMS, {**terms.TERMS, "seventh": made["SEVENTH"]}),
        "PARAMETERS": (terms.PARAMETERS, {**terms.PARAMETERS, "K7": made["SEVENTH"].parameters[0]}),
    }
    for module in list(sys.modules.values()):
        for name, (table, longer_table) in longer.items():
            if getattr(module, name, None) is table:
                monkeypatch.setattr(module, name, longer_table)


def stiffening(folder: Path) -> Path:
    """A recording of a joint whose spring has the page's term."""
    time = np.arange(0.0, 6.0, 0.002)
    angle = 0.4 * np.sin(2.0 * np.pi * 0.7 * time) + 0.2 * np.sin(2.0 * np.pi * 2.9 * time)
    rate = np.gradient(angle, time)
    noise = np.random.default_rng(1).normal(0.0, 1e-4, time.size)
    torque = 0.02 * angle + 2e-4 * rate + 0.15 * angle**7 + noise
    table, path = folder / "a.csv", folder / "a.h5"
    np.savetxt(table, np.column_stack([time, torque, angle]), "%.9g", ",", header="t,tau,angle", comments="")
    columns = ["--time", "t", "--torque", "tau", "--dtheta", "angle", "--torque-unit", "N*m", "--dtheta-unit", "rad"]
    assert run(["import", str(table), *columns, "--time-unit", "s", "-o", str(path)]) == 0
    return path


@pytest.mark.study
@pytest.mark.usefixtures("with_seventh")
def test_the_term_of_the_page_is_identified_in_a_table_that_was_made_with_it(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = stiffening(tmp_path)
    capfd.readouterr()
    assert run(["identify", str(path), "--model", "linear+offset+seventh", "--json"]) == 0
    values = {name: one["value"] for name, one in json.loads(capfd.readouterr().out)["parameters"].items()}
    assert values["Kc"] == pytest.approx(0.02, rel=0.01)
    assert values["Bc"] == pytest.approx(2e-4, rel=0.03)
    assert values["K7"] == pytest.approx(0.15, rel=0.02)
    assert terms.TERMS["seventh"].example.split()[0] == "K7"


IN_THE_FOLDER = """
import sys
import ga.model.effects
ga.model.effects.__path__.append(sys.argv[1])
from hil.cli.app import run
sys.exit(run(["identify", sys.argv[2], "--json"]))
"""


@pytest.mark.study
def test_model_selection_finds_the_term_of_the_page_when_its_module_is_put_into_the_folder(tmp_path: Path) -> None:
    (tmp_path / "effects").mkdir()
    (tmp_path / "effects" / "seventh.py").write_text(block("term"), encoding="utf-8")
    path = stiffening(tmp_path)
    words = [sys.executable, "-c", IN_THE_FOLDER, str(tmp_path / "effects"), str(path)]
    found = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
    assert found["model"] == "linear+seventh"
    assert found["parameters"]["K7"]["value"] == pytest.approx(0.15, rel=0.02)


@pytest.mark.study
def test_the_model_of_the_page_is_identified_from_its_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file, table, path = tmp_path / "my_model.py", tmp_path / "a.csv", tmp_path / "a.h5"
    file.write_text(block("model"), encoding="utf-8")
    time = np.arange(0.0, 4.0, 0.004)
    angle = 0.4 * np.sin(2.0 * np.pi * 0.7 * time) + 0.2 * np.sin(2.0 * np.pi * 2.9 * time)
    torque = 0.02 * np.sign(angle) * np.abs(angle) ** 1.3 + 2e-4 * np.gradient(angle, time)
    rows = np.column_stack([time, torque + np.random.default_rng(1).normal(0.0, 2e-5, time.size), angle])
    np.savetxt(table, rows, "%.9g", ",", header="t [s],tau [Nm],q [rad]", comments="")
    columns = ["--time", "t", "--torque", "tau", "--dtheta", "q"]
    assert run(["import", str(table), *columns, "-o", str(path)]) == 0

    capfd.readouterr()
    assert run(["identify", str(path), "--model", f"{file}:creeping", "--trials", "1", "--json"]) == 0
    values = {name: one["value"] for name, one in json.loads(capfd.readouterr().out)["parameters"].items()}
    assert values == pytest.approx({"Kc": 0.02, "Bc": 2e-4, "n": 1.3}, rel=0.03)
