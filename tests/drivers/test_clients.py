"""Independent clients, one model of each: the sessions of benchmarks/compatibility.py."""

from __future__ import annotations

import gc
import re
from typing import Any

import pytest

from .conftest import BENCHMARKS, benchmark

COMPATIBILITY = benchmark("compatibility")


@pytest.mark.study
@pytest.mark.filterwarnings("ignore:Exception ignored in.*ODriveCAN:pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("session", COMPATIBILITY.SESSIONS, ids=lambda session: f"{session.client} {session.backend}")
def test_a_client_that_is_not_ours_accepts_the_drive(session: Any) -> None:
    if not COMPATIBILITY.installed(session.client):
        how = COMPATIBILITY.INSTALL.get(session.client, session.client)
        pytest.skip(f"CLIENT NOT TESTED: {session.client} is not installed, pip install {how}")
    with COMPATIBILITY.emulated(session.backend, session.models[0]) as link:
        session.talk(link, session.models[0])
        gc.collect()  # odrive-can closes its bus a second time when it is collected


def test_the_page_names_every_client_and_model_and_no_failure() -> None:
    page = (BENCHMARKS.parent / "docs" / "compatibility.md").read_text(encoding="utf-8")
    assert "fails" not in page
    for session in COMPATIBILITY.SESSIONS:
        for model in session.models:
            row = rf"\| {session.client} \S+ \| {session.backend} \| .*\b{re.escape(model)}\b.* \|"
            assert re.search(row, page), model
