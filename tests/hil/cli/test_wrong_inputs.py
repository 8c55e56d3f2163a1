"""Every command, given what is no input of its: one sentence with status 2, and nothing of the libraries' words."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hil.cli.app import app

from ..conftest import Hil, Maker

FOREIGN = re.compile(
    r"Errno|list\[|Input should|pydantic|Traceback|fault in hil|\.hil-[0-9a-f]|object at 0x|Error\(|codec|<class|b'"
)
COLUMNS = ("--time", "t", "--torque", "q", "--dtheta", "a")
STAND = ("import", "good.csv", *COLUMNS, "-o", "o.h5", "--stand", "@")
COMMANDS: dict[str, list[tuple[tuple[str, ...], str]]] = {  # words with @ for the input, and its suffixes
    "record": [
        (("record", "--stand", "@"), ".toml"),
        (("record", "--backend", "replay", "@"), ".h5"),
        (("record", "--backend", "sim", "--profile", "file", "--setpoints", "@", "-o", "q.h5"), ".csv"),
    ],
    "identify": [
        (("identify", "@"), ".h5 .h5.part .csv"),
        (("identify", "good.h5", "@"), ".h5"),
        (("identify", "good.h5", "--fixture", "@"), ".h5"),
        (("identify", "good.h5", "--model", "@:NAME"), ".py"),
    ],
    "hysteresis": [(("hysteresis", "@"), ".h5 .csv")],
    "compare": [(("compare", "good.h5", "@"), ".h5")],
    "report": [(("report", "@", "-o", "r.html"), ".h5")],
    "inspect": [(("inspect", "@"), ".h5"), (("inspect", "@", "--verify"), ".h5 .csv")],
    "import": [
        (("import", "@", *COLUMNS, "-o", "o.h5"), ".csv .csv.gz .parquet .mat .mcap .db3 .txt .h5"),
        (("import", "@", "--topic", "/joint_states", "-o", "o.h5"), ".mcap .csv .mat"),
        (STAND, ".toml"),
    ],
    "export": [(("export", "@", "-o", "o.csv"), ".h5"), (("export", "@", "-o", "o.xml"), ".json .h5")],
    "recover": [(("recover", "@", "-o", "r.h5"), ".h5.part .h5")],
    "campaign": [(("campaign", "@"), ".toml")],
    "hand": [(("hand", "@"), ".toml")],
    "design": [(("design", "--stand", "@"), ".toml")],
    "view": [(("view", "@"), ".h5")],
    "doctor": [(("doctor", "@"), ".toml")],
    "calibrate": [(("calibrate", "zero", "@"), ".toml")],
}
WITHOUT_INPUT = {"demo", "emulate", "replicate", "stand", "studio"}
CASES = [(words, suffix) for rows in COMMANDS.values() for words, suffixes in rows for suffix in suffixes.split()]


def wrong_input(name: str) -> None:
    """Make a folder, an empty file or one of every byte, as its name says."""
    path = Path(name)
    if path.name.startswith("folder"):
        path.mkdir()
    elif path.name.startswith(("empty", "junk")):
        path.write_bytes(bytes(range(256)) * 40 if path.name.startswith("junk") else b"")


@pytest.mark.parametrize(("words", "suffix"), CASES, ids=lambda value: value if isinstance(value, str) else value[0])
def test_a_wrong_input_is_one_sentence_of_our_own(
    hil: Hil, tmp_path: Path, make_recording: Maker, words: tuple[str, ...], suffix: str
) -> None:
    if "good.h5" in words:
        make_recording("good.h5", samples=300, noise=1e-5)
    Path("good.csv").write_text("t [s],q [N*m],a [rad]\n0,1,2\n1,2,3\n")
    for kind in ("missing", "folder", "empty", "junk"):
        name = kind + suffix
        wrong_input(name)
        before = sorted(path.name for path in tmp_path.iterdir())
        status, out, err = hil(*(word.replace("@", name) for word in words))
        assert (status, out) == (2, ""), name
        assert err.strip()
        assert not FOREIGN.search(err), err
        assert name in err
        assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_every_command_has_a_row() -> None:
    named = {command.name for command in app.registered_commands} | {group.name for group in app.registered_groups}
    assert named == set(COMMANDS) | WITHOUT_INPUT


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("identify", "a.h5", "--trials", "0"), "Invalid value for '--trials': '0' must be at least 1"),
        (("identify", "a.h5", "--trials", "x"), "Invalid value for '--trials': 'x' must be a whole number"),
        (("record", "--seed", "-1"), "Invalid value for '--seed': '-1' must be at least 0"),
        (("record", "--mode", "speed"), "Invalid value for '--mode': 'speed' is not one of 'torque', 'position'"),
        (("doctor", "--rate", "1e9"), "Invalid value for '--rate'"),
        (("inspect", "--nope"), "No such option: --nope"),
        (("inspect",), "Missing argument 'recording'"),
    ],
)
def test_a_wrong_option_is_said_in_our_own_words(hil: Hil, words: tuple[str, ...], said: str) -> None:
    status, out, err = hil(*words)
    assert (status, out) == (2, "")
    assert said in err
    assert not FOREIGN.search(err), err


@pytest.mark.parametrize("command", sorted(name for name in COMMANDS if name != "calibrate"))
def test_no_help_names_a_type_of_python(hil: Hil, command: str) -> None:
    status, out, _ = hil(command, "--help")
    assert status == 0
    assert not re.search(r"list\[|Path\]|<str \| None>", out)
