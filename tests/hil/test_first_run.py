from __future__ import annotations

import sys

import pytest

from hil import first_run


def test_the_process_that_compiles_ahead_ends_with_the_identification(monkeypatch: pytest.MonkeyPatch) -> None:
    """That no child is left running is what every test is held to."""
    started: list[str] = []

    def never_ending(module: str) -> list[str]:
        started.append(module)
        return [sys.executable, "-c", "import time; time.sleep(600)"]

    monkeypatch.setattr(first_run, "command", never_ending)
    monkeypatch.setattr(first_run, "is_worthwhile", lambda: True)
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    with first_run.compiled_ahead():
        with first_run.compiled_ahead():  # by the command, and by the identification that it calls
            assert started == ["ga.trials.ahead"]
        assert [one.poll() for one in first_run._processes] == [None]
    assert first_run._processes == []
    monkeypatch.setattr(first_run, "is_worthwhile", lambda: False)
    with first_run.compiled_ahead():
        pass
    assert started == ["ga.trials.ahead"]
