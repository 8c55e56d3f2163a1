"""`hil identify --each`: identify each recording separately."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hil.cli.progress import progress
from hil.cli.terminal import UNTRUSTWORTHY, out, print_diagnostics, print_json, say
from hil.errors import WrongUse

if TYPE_CHECKING:
    from hil.api.results import IdentificationResult


def refuse_with_each(given: Mapping[str, Any]) -> None:
    """Raise WrongUse if an option cannot be used with --each. given: value of each option, None if it was not given."""
    for name, value in given.items():
        if value is not None:
            raise WrongUse(f"--{name} cannot be used with --each: leave out one of the two")


def meets(found: IdentificationResult, required: tuple[str, ...]) -> bool:
    """Return whether the required parameters may be trusted. If only one parameter is required, the model must have
    it.
    """
    if len(required) == 1 and required[0] not in found.parameters:
        say(f"error: model {found.model} has no {required[0]}, which --require asks for")
        return False
    return all(map(found.trusted, required))


def identify_each(
    recordings: Sequence[Path], model: str | None, options: dict[str, Any], required: tuple[str, ...], *, as_json: bool
) -> None:
    """Print the result of each recording, and end with the exit status of the worst result."""
    from hil.api.analysis import identify_each as identify
    from hil.api.results import NoResult

    with progress() as show:
        found = identify(recordings, model, progress=show, **options)
    if as_json:
        print_json({"schema": "hil-identifications/1", "results": [one.as_json() for one in found]})
    for path, one in zip(recordings, found, strict=True):
        if isinstance(one, NoResult):
            say(f"error [unusable]: {path}: {one}")
            continue
        if not as_json:
            out(f"{path}: {one}")
        print_diagnostics([replace(other, message=f"{path}: {other.message}") for other in one.diagnostics])
    if not all(not isinstance(one, NoResult) and meets(one, required) for one in found):
        raise typer.Exit(UNTRUSTWORTHY)
