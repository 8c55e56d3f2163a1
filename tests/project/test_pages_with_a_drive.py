"""Every block of a page that starts an emulated drive runs as pasted, on a machine that other programs use too."""

from __future__ import annotations

from pathlib import Path

import pytest

from .pages import Reader, has_a_drive, page_names, read


@pytest.mark.study
@pytest.mark.timeout(1800)  # all commands of a page, twice, beside busy programs
@pytest.mark.filterwarnings("default:pasted again")
@pytest.mark.parametrize("page", [page for page in page_names() if has_a_drive(page)])
def test_every_block_of_a_page_runs_as_pasted_and_pasted_again_on_a_busy_machine(page: str, tmp_path: Path) -> None:
    reader = Reader(tmp_path)
    read(reader, page)
    read(reader, page, busy=True)
