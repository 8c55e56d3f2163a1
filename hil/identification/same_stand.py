"""What recordings that are taken together must have in common: one stand, and no run among them twice."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.recording.reader import Recording
from hil.stand.file import parse


def check_together(paths: Sequence[Path]) -> list[Diagnostic]:
    """What is to be said of the stands of recordings that are pooled or compared.

    Raises WrongUse where two are of stands with different names, or are the same run.
    """
    seen: dict[str, Path] = {}
    stands: list[tuple[Path, dict[str, Any]]] = []
    unknown = []
    for path in paths:
        with Recording(path) as recording:
            uid = str(recording.attributes.get("uid", "")) or str(path.resolve())
            if uid in seen:
                raise WrongUse(f"{path} is the same run as {seen[uid]}: name it once")
            seen[uid] = path
            if recording.stand_toml:
                stands.append((path, _facts(recording)))
            else:
                unknown.append(str(path))
    found = [diagnostic for path, facts in stands[1:] for diagnostic in _compared(*stands[0], path, facts)]
    if stands and unknown:
        found.append(
            Diagnostic(
                "stand-unknown",
                f"{', '.join(unknown)} name(s) no stand, unlike {stands[0][0]}: make sure that it is the same one",
            )
        )
    return found


def _facts(recording: Recording) -> dict[str, Any]:
    """What the stand file says of the stand and its limits, key by key; the backend drives it and is not it."""
    stand = parse(recording.stand_toml, f"{recording.path}: stand_toml")
    facts: dict[str, Any] = stand.stand.model_dump(exclude={"backend"})
    if stand.limits is not None:
        facts |= {f"limits.{name}": value for name, value in stand.limits.model_dump().items()}
    return facts


def _compared(first: Path, known: dict[str, Any], path: Path, facts: dict[str, Any]) -> list[Diagnostic]:
    if facts["name"] != known["name"]:
        raise WrongUse(
            f"{path} is of the stand {facts['name']!r} and {first} of {known['name']!r}: take recordings of one stand"
        )
    changed = [
        f"{key} {facts.get(key, 'not set')} instead of {known.get(key, 'not set')}"
        for key in sorted(facts.keys() | known.keys())
        if facts.get(key) != known.get(key)
    ]
    if not changed:
        return []
    return [Diagnostic("stand-changed", f"{path} was made with {', '.join(changed)} in {first}: is it the same stand?")]
