"""Check that pooled or compared recordings are of one stand, and that no run is among them twice."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.signals.constants import INTERVAL
from hil.signals.source import Source
from hil.stand.file import Stand


def same_stand_diagnostics(sources: Sequence[Source]) -> list[Diagnostic]:
    """Return a warning for each stand that differs from the first, and for recordings that name no stand.

    Raises WrongUse if two recordings are of stands with different names, or are the same run.
    """
    seen: dict[str, Path] = {}
    stands: list[tuple[Path, dict[str, Any]]] = []
    unknown = []
    for source in sources:
        path = source.path
        uid = str(source.recording.attributes.get("uid", "")) or str(path.resolve())
        if uid in seen:
            raise WrongUse(f"{path} is the same run as {seen[uid]}: name it once")
        seen[uid] = path
        if source.stand is None:
            unknown.append(str(path))
        else:
            stands.append((path, _facts(source.stand) | {"torque scale": source.torque_scale.source or "not known"}))
    found = [diagnostic for path, facts in stands[1:] for diagnostic in _compared(*stands[0], path, facts)]
    if stands and unknown:
        found.append(
            Diagnostic(
                "other-stand",
                f"{', '.join(unknown)}: no stand is named, but {stands[0][0]} names one. Make sure that all are of the "
                "same stand",
            )
        )
    return found


def other_joints_diagnostics(sources: Sequence[Source]) -> list[Diagnostic]:
    """Return a diagnostic for each imported recording in which other joints moved as this one did.

    It is an error where a coupling to them that is as stiff as Kc would change Kc by more than a trusted interval is
    wide.
    """
    found = []
    for source in sources:
        profile = source.recording.profile
        if follow := float(profile.get("other_joints_follow", 0.0)):
            text = (
                f"{source.path}: {profile['other_joints']} moved too, and their motion explains "
                f"{float(profile['other_joints_repeat']):.1%} of that of this joint. Kc contains the torque of the "
                f"coupling to them: a coupling as stiff as Kc changes it by {follow:.0%}. Record again with the other "
                "joints at rest"
            )
            found.append(Diagnostic("not-identifiable", text, is_error=follow > INTERVAL))
    return found


def calibration_diagnostics(sources: Sequence[Source]) -> list[Diagnostic]:
    """Return a warning for each calibration that was old when a recording was made, or that was not in use at that
    time.
    """
    found: dict[str, Diagnostic] = {}
    for source in sources:
        created = str(source.recording.attributes.get("created", ""))
        if source.stand is not None and created:
            with suppress(ValueError):  # a date of another program's making
                at = datetime.fromisoformat(created)
                at = at if at.tzinfo else at.replace(tzinfo=UTC)
                found |= {one.message: one for one in source.stand.calibration_diagnostics(at)}
    return list(found.values())


def _facts(stand: Stand) -> dict[str, Any]:
    """Return the keys and values of [stand] and [limits], except the backend, which only drives the stand."""
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
        f"{key} {facts.get(key, 'not set')} (not {known.get(key, 'not set')})"
        for key in sorted(facts.keys() | known.keys())
        if facts.get(key) != known.get(key)
    ]
    if not changed:
        return []
    text = (
        f"the stand of {path} differs from that of {first}: {', '.join(changed)}. Make sure that it is the same stand"
    )
    return [Diagnostic("other-stand", text)]
