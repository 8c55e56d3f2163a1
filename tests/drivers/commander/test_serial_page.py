"""docs/serial.md is run, not believed: its stand file, and its commands against the emulators they start."""

from __future__ import annotations

import re
import shlex
import threading
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from drivers.commander.config import CommanderConfig
from drivers.loadcell.config import LoadCellConfig
from drivers.servo import Status
from hil.cli.app import run
from hil.recording.reader import Recording
from hil.signals.prepare import prepare
from hil.stand.file import parse
from sim_backend.wire.catalogue import make
from sim_backend.wire.commander import emulator

UNANSWERED = Status.NO_REPLY | Status.BAD_REPLY | Status.MISSED
PAGE = (Path(__file__).parents[3] / "docs/serial.md").read_text(encoding="utf-8")


def block(mark: str) -> str:
    found = re.search(rf"<!-- {mark} -->\s*```\w+\n(.+?)\n```", PAGE, re.DOTALL)
    assert found is not None
    return found[1]


@pytest.mark.study
@pytest.mark.usefixtures("busy_machine")
def test_the_commands_of_the_page_run_on_its_stand_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(emulator, "WATCHDOG", 1.0)  # a busy machine keeps a board waiting that lives in this process
    stand, count = re.subn(r"watchdog = 0.1", "watchdog = 1.0\nreply_timeout = 0.3", block("write stand.toml"))
    assert count == 1
    (tmp_path / "stand.toml").write_text(stand)
    emulate, *commands, _ = block("commands").splitlines()
    name, *words = shlex.split(emulate.split("(")[1])[2:-1]
    options = dict(zip(words[::2], words[1::2], strict=True))
    given = {"link": Path(options["--link"]), "model": options["--model"], "firmware": options["--firmware"]}
    served = make(name, given)
    thread = threading.Thread(target=served.serve)
    thread.start()
    try:
        for command in commands:
            # both ends share this process, and its machine with other tests: that ticks are late may be found (1)
            code = run(shlex.split(command.replace("--rate 100", "--rate 60"))[1:])
            assert code in ({0} if " doctor " in command else {0, 1}), command
    finally:
        served.stop()
        thread.join()
    assert not (tmp_path / "ttyFOC.cell").is_symlink()
    with Recording(tmp_path / "run.h5") as recording:
        signals = prepare(recording, parse(stand).stand)
        joint, status = recording.channel("joint_torque"), recording.channel("status")
    answered = (status.astype(int) & UNANSWERED) == 0  # how many ticks a busy machine misses says nothing of the cell
    assert np.isfinite(joint[answered]).mean() > 0.9
    kc = float(
        np.linalg.lstsq(
            np.column_stack([signals.motion.dtheta, signals.motion.dtheta_dot]), signals.torque, rcond=None
        )[0][0]
    )
    assert kc == pytest.approx(17.75e-3, rel=0.1)


def test_the_page_names_every_key_of_both_tables() -> None:
    for table in (CommanderConfig, LoadCellConfig):
        for field in fields(table):
            assert field.name == "port" or f"| `{field.name}` |" in PAGE, field.name
