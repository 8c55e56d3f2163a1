"""`pytest --stand FILE`: the servo contract, run against the stand of a file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from sim_backend.wire.dynamixel.emulator import serve

from .conftest import STAND

PYTEST = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
CONTRACT = Path(__file__).parent / "test_servo_contract.py"


@pytest.mark.study
def test_the_contract_runs_against_the_stand_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "stand.toml"
    path.write_text(STAND.format(port=tmp_path / "ttyDXL"))
    with serve(tmp_path / "ttyDXL", "xl330-m288"):
        run = subprocess.run(
            [*PYTEST, str(CONTRACT), "--stand", str(path), "-k", "turns_the_motor_forwards or closing_twice"],
            cwd=CONTRACT.parent.parent.parent,
            capture_output=True,
            text=True,
            check=False,
        )
    assert run.returncode == 0, run.stdout
    assert "2 passed" in run.stdout
