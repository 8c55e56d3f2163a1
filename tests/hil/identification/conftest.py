"""What the tests of identification share."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def sound_files_are_opened_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Try no recording out in a copy of this process, 50 ms each: the tests have just written it themselves."""
    monkeypatch.setattr("hil.recording.reader.in_child", lambda work, **_: work())
