"""The option --report that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def check_report(report: Path | None, inputs: Sequence[Path], *, force: bool) -> None:
    """Raise WrongUse, before any work is done, where the report would overwrite a file."""
    from hil.recording.output import check_output
    from hil.report.page import page_files

    for path in () if report is None else page_files(report):
        check_output(path, force=force, inputs=inputs)
