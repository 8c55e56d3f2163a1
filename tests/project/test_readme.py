"""The README is run, not believed: its transcript, its stand file and its commands."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from hil.cli.app import run
from hil.stand.file import parse
from sim_backend.wire.dynamixel.emulator import serve
from sim_backend.wire.packets.bus import PacketTiming

ROOT = Path(__file__).parent.parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(mark: str, language: str) -> str:
    found = re.search(rf"<!-- {mark} -->\s*```{language}\n(.+?)\n```", README, re.DOTALL)
    assert found is not None
    return found[1]


NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
MACHINE = re.compile(
    r"optimiser gap \S+|\d+ evaluations in \S+ s|^searching: .* left$|^compiling, first run only.*$", re.MULTILINE
)
"""What depends on the machine and the moment: the optimiser's last digits, times, and progress after 10 s."""


def lines(text: str) -> list[tuple[str, list[str]]]:
    """The words of every line, sorted, with its numbers: tables and messages come from two streams."""
    shown = [" ".join(line.split()) for line in MACHINE.sub("...", text).splitlines() if line.strip(" .")]
    return sorted((NUMBER.sub("#", line), NUMBER.findall(line)) for line in shown)


def assert_alike(shown: str, printed: str) -> None:
    """Words are equal and numbers within 1 % or the last digit shown: other processors round sums differently."""
    expected, found = lines(shown), lines(printed)
    assert [words for words, _ in expected] == [words for words, _ in found]
    for (words, numbers), (_, others) in zip(expected, found, strict=True):
        for number, other in zip(numbers, others, strict=True):
            digits = len(number.partition("e")[0].partition(".")[2])
            digit = 1.01 * 10.0**-digits if digits else 0.0
            assert float(other) == pytest.approx(float(number), rel=0.01, abs=digit), words


@pytest.mark.parametrize(
    ("shown", "printed", "alike"),
    [
        ("Kc  17.783 mN m/rad", "Kc 17.79 mN m/rad", True),
        ("Kc 17.783 mN m/rad", "Kc 18.1 mN m/rad", False),
        ("gain -3.89", "gain -3.87", True),
        ("17.76 +- 0.02", "17.77 +- 0.03", True),
        ("17.76 +- 0.02", "17.76 +- 0.04", False),
        ("gain -3.89", "gain 3.89", False),
        ("Kc 17.783, included", "Kc 17.783, rejected", False),
        ("optimiser gap 3.4e-10", "optimiser gap 2.9e-11", True),
    ],
)
def test_a_wrong_word_or_number_in_the_transcript_is_noticed(shown: str, printed: str, *, alike: bool) -> None:
    if alike:
        assert_alike(shown, printed)
    else:
        with pytest.raises(AssertionError):
            assert_alike(shown, printed)


def test_the_transcript_is_what_the_program_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    parts = re.split(r"^\$ (hil .+)$", block("transcript", "console"), flags=re.MULTILINE)
    for command, shown in zip(parts[1::2], parts[2::2], strict=True):
        assert run(shlex.split(command)[1:]) == 0
        out, err = capfd.readouterr()
        assert_alike(shown, out + err)


def test_the_commands_for_ones_own_stand_run_on_the_stand_file_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hil.report.html_page.svg", lambda _: "<svg/>")  # that of the transcript is drawn
    text = block("write stand.toml", "toml")
    assert parse(text).sim.coupling.stiffness == 0.02
    (tmp_path / "stand.toml").write_text(text)
    for command in (block("own stand", "sh") + "\n" + block("table", "sh")).splitlines():
        assert run(shlex.split(command)[1:]) == 0, command
    assert (tmp_path / "mine.html").exists()


@pytest.mark.usefixtures("busy_machine")
def test_the_commands_for_a_drive_run_against_the_emulated_servo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    emulate, *commands = block("a drive", "sh").splitlines()
    words = dict(zip(shlex.split(emulate)[3:-1:2], shlex.split(emulate)[4:-1:2], strict=True))
    assert emulate.startswith("hil emulate dynamixel ")
    assert emulate.endswith(" &")
    with serve(Path(words["--link"]), timing=PacketTiming()):
        for command in commands:
            # both ends share this process, and its machine with other tests: that ticks are late may be found (1)
            assert run(shlex.split(command)[1:]) in ({0, 1} if " identify " in command else {0}), command
            if " stand new " in command:
                be_patient(tmp_path / "servo.toml")


def be_patient(stand: Path) -> None:
    """Let a busy machine keep the emulated servo waiting, which lives in this very process."""
    text = stand.read_text()
    for key, value in (("reply_timeout", "0.3  "), ("watchdog", "1.0")):
        text, count = re.subn(rf"# {key} = \S+", f"{key} = {value}", text)
        assert count == 1
    stand.write_text(text)


def test_every_page_and_picture_the_readme_points_to_is_there() -> None:
    targets = re.findall(r"\]\((\S+?)\)", README)
    assert len(targets) >= 5
    assert [target for target in targets if not (ROOT / target).exists()] == []
