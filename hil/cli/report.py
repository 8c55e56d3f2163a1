"""The option --report that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def check_report(report: Path | None, inputs: Sequence[Path], *, force: bool) -> None:
    """Raise WrongUse, before any work is done, where the report would overwrite a file or has another's suffix."""
    from hil.recording.output import check_output
    from hil.report.html_page import check_page_name

    if report is not None:
        check_output(check_page_name(report), force=force, inputs=inputs)
