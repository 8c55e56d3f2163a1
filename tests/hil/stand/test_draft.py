"""Stand files that nobody had to write by hand, and the schema that helps whoever does."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import pytest

from drivers.ports import Port
from hil.cli.app import run
from hil.stand.devices import BACKENDS
from hil.stand.draft import Draft
from hil.stand.file import load, parse
from hil.stand.json_schema import stand_schema

COPY = Path(__file__).parents[3] / "docs" / "stand.schema.json"
ANSWERS = ["--set", "dynamixel.port=/dev/ttyUSB0", "--set", "dynamixel.model=xl330-m288"]


def test_a_script_gets_a_stand_file_from_its_options_alone(tmp_path: Path) -> None:
    path = tmp_path / "stand.toml"
    words = ["--set", "stand.gear_ratio=6", "--set", "limits.torque=0.1", "--set", "dynamixel.id=3"]
    assert run(["stand", "new", "--yes", "--backend", "dynamixel", *ANSWERS, *words, "-o", str(path)]) == 0
    stand = load(path)
    assert (stand.stand.backend, stand.stand.gear_ratio, stand.checked_limits().torque) == ("dynamixel", 6.0, 0.1)
    assert (stand.devices["dynamixel"].port, stand.devices["dynamixel"].id) == ("/dev/ttyUSB0", 3)


def test_every_key_of_a_new_file_is_there_with_its_meaning(tmp_path: Path) -> None:
    path = tmp_path / "stand.toml"
    assert run(["stand", "new", "--yes", "--backend", "dynamixel", *ANSWERS, "-o", str(path)]) == 0
    text = path.read_text()
    for key in Draft("dynamixel", None).keys():  # noqa: SIM118 - not a mapping
        assert f"{key.partition('.')[2]} = " in text, key
    assert "# watchdog = 0.1              # s without a request" in text
    uncommented = "\n".join(
        line.removeprefix("# ") if " = " in line and "..." not in line else line for line in text.splitlines()
    )
    assert parse(uncommented).devices["dynamixel"].watchdog == 0.1


def test_a_person_is_asked_again_until_the_answer_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "stand.toml"
    drive = ["dynamixel", ""]  # and no sensor at the joint
    typed = [*drive, "my finger", "-3", "2", "", "", "elbow", "motor", "/dev/ttyUSB1", "xl1", "xl330-m288", "0.05"]
    here = [Port("/dev/ttyUSB0", "FT232"), Port("/dev/ttyUSB1", "")]
    monkeypatch.setattr("drivers.ports.serial_ports", lambda: here)
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join([*typed, "", "", ""]) + "\n"))
    assert run(["stand", "new", "-o", str(path)]) == 0
    shown = capfd.readouterr()
    assert shown.out.strip() == ""
    for message in (
        "-3: must be at least 0.001",
        "elbow: must be '",
        "xl1: must be 'mx-106'",
        "dynamixel.port is one of: /dev/ttyUSB0 (FT232), /dev/ttyUSB1\n",
        "dynamixel.model is one of: mx-106, ",
    ):
        assert message in shown.err
    stand = load(path)
    assert (stand.stand.name, stand.stand.gear_ratio, stand.checked_limits().torque) == ("my finger", 2.0, 0.05)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--backend", "dynamixel"], "add --set dynamixel.port="),
        (["--backend", "mit"], "mit.model is one of: ak10-9, "),
        (["--backend", "dinamixel"], "did you mean 'dynamixel'"),
        (["--backend", "dynamixel", "--set", "dynamixel.prt=x"], "did you mean 'dynamixel.port'"),
        (["--set", "limits.torque"], "write KEY=VALUE"),
        (["--set", "limits.torque=-1"], "must be above 0"),
        (["--backend", "dynamixel", *ANSWERS, "--set", "dynamixel.watchdog=0.01"], "one lost reply would stop"),
        (["--sensor", "elbow"], "unknown joint sensor 'elbow'"),
    ],
)
def test_what_cannot_be_written_is_refused_and_nothing_is_left(
    words: list[str], message: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(["stand", "new", "--yes", *words, "-o", str(tmp_path / "stand.toml")]) == 2
    assert message in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_stand_file_is_not_overwritten_unless_forced(tmp_path: Path) -> None:
    path = tmp_path / "stand.toml"
    path.write_text("mine")
    assert run(["stand", "new", "--yes", "-o", str(path)]) == 2
    assert path.read_text() == "mine"
    assert run(["stand", "new", "--yes", "-o", str(path), "--force"]) == 0
    assert load(path).stand.backend == "sim"


def test_the_schema_in_the_documentation_is_the_one_the_command_prints(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["stand", "schema"]) == 0
    printed = capfd.readouterr().out
    assert json.loads(printed) == stand_schema()
    assert COPY.read_text() == printed, "write it anew: hil stand schema > docs/stand.schema.json"


def test_the_schema_knows_every_backend_and_forbids_unknown_keys() -> None:
    schema = stand_schema()
    assert schema["$defs"]["StandTable"]["properties"]["backend"]["enum"] == list(BACKENDS)
    assert schema["required"] == ["stand"]
    for name in BACKENDS:
        definition = schema["$defs"][schema["properties"][name]["$ref"].rpartition("/")[2]]
        assert definition["additionalProperties"] is False
    models = schema["$defs"]["DynamixelConfig"]["properties"]["model"]["enum"]
    assert "xl330-m288" in models
