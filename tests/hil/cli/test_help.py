"""The help of every command, its examples, and the options that stand anywhere."""

from __future__ import annotations

import re
import shlex
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import typer.main

from hil.cli.app import app, run
from hil.cli.examples import EXAMPLES, STATUSES

from ..conftest import Hil, Maker


def commands(group: Any, before: tuple[str, ...] = ()) -> dict[str, Any]:
    """Every command by its whole name."""
    found: dict[str, Any] = {}
    for name, command in group.commands.items():
        words = (*before, name)
        found |= commands(command, words) if hasattr(command, "commands") else {" ".join(words): command}
    return found


COMMANDS = commands(typer.main.get_command(app))


def test_every_command_has_an_example_and_no_other_has() -> None:
    assert set(EXAMPLES) == set(COMMANDS)


def test_the_help_of_a_command_shows_its_examples_whole(hil: Hil) -> None:
    for name in COMMANDS:
        shown = hil(*name.split(), "--help").out
        assert [example for example in EXAMPLES[name] if f"  {example}\n" not in f"{shown}\n"] == []


def test_an_example_is_a_command_with_options_that_exist() -> None:
    for name, example in [(one, example) for one in COMMANDS for example in EXAMPLES[one]]:
        words = shlex.split(example)
        assert words[: 1 + len(name.split())] == ["hil", *name.split()]
        context = COMMANDS[name].make_context(name, words[1 + len(name.split()) :])
        assert context.args == []


def test_the_help_lists_every_exit_status(hil: Hil) -> None:
    shown = hil("--help").out
    for status in STATUSES:
        assert f"  {status}\n" in f"{shown}\n"
    assert "--install-completion" in shown


def test_the_version_is_that_of_the_package(hil: Hil) -> None:
    assert hil("--version").out == f"hil {version('hil')}\n"


def test_quiet_prints_the_answer_alone_wherever_it_stands(hil: Hil, make_recording: Maker) -> None:
    path = make_recording(noise=1e-4, samples=2000, rate=2000.0)
    settings = ("--model", "linear", "--trials", 1)
    before = hil("--quiet", "identify", path, *settings)
    after = hil("identify", path, "--quiet", "--report", "r.html", *settings)
    assert before.out.startswith("Kc = ")
    assert len(before.out.splitlines()) == 1
    for quiet in (before, after):
        assert quiet.out == before.out
        assert quiet.err == ""
    assert Path("r.html").exists()


def test_quiet_keeps_the_errors(hil: Hil, make_recording: Maker) -> None:
    ended = hil("identify", make_recording(samples=8), "--quiet")
    assert ended.status == 1
    assert ended.err


def test_the_stand_file_of_the_folder_is_used_and_said(hil: Hil) -> None:
    assert "which stand?" in hil("record").err
    hil("stand", "new", "--yes", "--backend", "sim")
    ended = hil("record", "--duration", 1, "--fade", 0.2, "-o", "a.h5")
    assert ended.status == 0
    assert "using stand.toml" in ended.err
    assert "using" not in hil("record", "--backend", "sim", "--duration", 1, "--fade", 0.2, "-o", "b.h5").err


def test_a_new_stand_refuses_a_wrong_drive_before_it_asks_for_more(hil: Hil) -> None:
    ended = hil("stand", "new", "--backend", "dynamixl")
    assert ended.status == 2
    assert "did you mean 'dynamixel'" in ended.err


def test_a_new_stand_names_every_missing_answer_at_once(hil: Hil) -> None:
    ended = hil("stand", "new", "--yes", "--backend", "loadcell-less")
    assert ended.status == 2
    ended = hil("stand", "new", "--yes", "--backend", "commander", "--sensor", "loadcell")
    assert ended.status == 2
    missing = re.findall(r"--set (\S+)=\.\.\.", ended.err)
    assert len(missing) >= 2
    words = [word for key in missing for word in ("--set", f"{key}=1")]
    assert "there is no default" not in hil("stand", "new", "--yes", "--backend", "commander", *words).err


@pytest.mark.parametrize("name", ["chrip", "multisin", "prsb"])
def test_a_misspelt_profile_is_guessed(hil: Hil, name: str) -> None:
    assert "did you mean" in hil("record", "--backend", "sim", "--profile", name).err


@pytest.mark.parametrize(("typed", "expected"), [("hil ide", ["identify"]), ("hil inspect --ver", ["--verify"])])
def test_the_shell_completes_commands_and_options(
    typed: str, expected: list[str], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """As the script that --install-completion writes asks for it."""
    asked = {"_HIL_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": f"{typed.count(' ')}"}
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit):
        run([])
    assert capfd.readouterr().out.split() == expected
