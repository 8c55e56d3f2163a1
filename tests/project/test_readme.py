"""The README is run, not believed: its transcript, its stand file and its commands."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from hil.cli.app import run
from hil.stand.file import parse
from sim_backend.wire.dynamixel.emulator import emulate as served

ROOT = Path(__file__).parent.parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(mark: str, language: str) -> str:
    found = re.search(rf"<!-- {mark} -->\s*```{language}\n(.+?)\n```", README, re.DOTALL)
    assert found is not None
    return found[1]


def plain(text: str) -> list[str]:
    """Lines without what belongs to the machine and the moment: times, progress, and the search's last digits."""
    text = re.sub(r"^searching: .* left\n", "", text, flags=re.MULTILINE)  # said of what takes longer than 10 s
    for changing in (r"± \S+", r"error is \S+", r"\d+ evaluations in \S+ s"):
        text = re.sub(changing, "...", text)
    return [re.sub(r"\s+", " ", line).strip() for line in text.splitlines() if line.strip()]


def test_the_transcript_is_what_the_program_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    parts = re.split(r"^\$ (hil .+)$", block("transcript", "console"), flags=re.MULTILINE)
    for command, shown in zip(parts[1::2], parts[2::2], strict=True):
        assert run(shlex.split(command)[1:]) == 0
        out, err = capfd.readouterr()
        assert sorted(plain(shown)) == sorted(plain(out + err)), command


def test_the_commands_for_ones_own_stand_run_on_the_stand_file_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = block("stand", "toml")
    assert parse(text).sim.coupling.stiffness == 0.02
    (tmp_path / "stand.toml").write_text(text)
    for command in block("own stand", "sh").splitlines():
        assert run(shlex.split(command)[1:]) == 0, command
    assert (tmp_path / "mine.png").exists()


def test_the_commands_for_a_drive_run_against_the_emulated_servo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    emulate, *commands = block("a drive", "sh").splitlines()
    words = dict(zip(shlex.split(emulate)[3:-1:2], shlex.split(emulate)[4:-1:2], strict=True))
    assert emulate.startswith("hil emulate dynamixel ")
    assert emulate.endswith(" &")
    with served(Path(words["--link"])):
        for command in commands:
            assert run(shlex.split(command)[1:]) == 0, command
            if " stand new " in command:
                be_patient(tmp_path / "servo.toml")


def be_patient(stand: Path) -> None:
    """Let a busy machine keep the emulated servo waiting, which lives in this very process."""
    text = stand.read_text()
    for key, value in (("reply_timeout", "0.3  "), ("watchdog", "1.0")):
        text, count = re.subn(rf"# {key} = \S+", f"{key} = {value}", text)
        assert count == 1
    stand.write_text(text)


def test_the_import_command_runs_on_such_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rows = "\n".join(f"{index / 100},{index % 7},{index % 5}" for index in range(100))
    (tmp_path / "log.csv").write_text(f"t,tau,angle\n{rows}\n")
    commands = [line for line in README.splitlines() if line.startswith("hil import")]
    assert len(commands) == 1
    assert run(shlex.split(commands[0])[1:]) == 0


def test_every_page_and_picture_the_readme_points_to_is_there() -> None:
    targets = re.findall(r"\]\((\S+?)\)", README)
    assert len(targets) >= 5
    assert [target for target in targets if not (ROOT / target).exists()] == []
