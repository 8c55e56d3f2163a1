"""docs/feetech.md is run, not believed: its session against the emulator that it starts."""

from __future__ import annotations

import re
import shlex
import threading
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from drivers.feetech.config import FeetechConfig
from hil.cli.app import run
from hil.recording.reader import Recording
from hil.signals.prepare import prepare
from hil.stand.file import load
from sim_backend.wire.catalogue import make

PAGE = (Path(__file__).parents[3] / "docs/feetech.md").read_text(encoding="utf-8")


def commands() -> list[str]:
    found = re.search(r"<!-- commands -->\s*```\w+\n(.+?)\n```", PAGE, re.DOTALL)
    assert found is not None
    return found[1].splitlines()


@pytest.mark.study
@pytest.mark.usefixtures("busy_machine")
def test_the_session_of_the_page_gives_a_stiffness(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    new, emulate, *rest, _ = commands()
    assert run([*shlex.split(new)[1:], "--set", "feetech.reply_timeout=0.3"]) == 0
    name, *words = shlex.split(emulate.split("(")[1])[2:-1]
    options = dict(zip(words[::2], words[1::2], strict=True))
    served = make(name, {"link": Path(options["--link"]), "model": options["--model"]})
    thread = threading.Thread(target=served.serve)
    thread.start()
    try:
        for command in rest:
            # both ends share this process, and its machine with other tests: that ticks are late may be found (1)
            code = run(shlex.split(command.replace("--rate 100", "--rate 50"))[1:])
            assert code in ({0} if " doctor " in command else {0, 1}), command
    finally:
        served.stop()
        thread.join()
    with Recording(tmp_path / "run.h5") as recording:
        signals = prepare(recording, load(tmp_path / "stand.toml").stand)
    design = np.column_stack([signals.motion.dtheta, signals.motion.dtheta_dot])
    kc = float(np.linalg.lstsq(design, signals.torque, rcond=None)[0][0])
    assert kc == pytest.approx(17.75e-3, rel=0.1)


def test_the_page_names_every_key() -> None:
    for field in fields(FeetechConfig):
        assert field.name == "port" or f"| `{field.name}` |" in PAGE, field.name
