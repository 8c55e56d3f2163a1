"""Diagnostics: the warnings and errors about a recording, a run or a result, each with a code and a remedy."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """A warning, or an error: then the result must not be trusted.

    code: a fixed name for scripts. message: what is wrong, what it means for Kc or Bc, and what to do. parameter: the
    one that is affected, None where all are.
    """

    code: str
    message: str
    parameter: str | None = None
    is_error: bool = False

    @property
    def severity(self) -> str:
        """Return "error" or "warning"."""
        return "error" if self.is_error else "warning"

    def as_json(self) -> dict[str, str | None]:
        """Return the entry for the lists "warnings" and "errors" of every command's JSON."""
        return {"code": self.code, "parameter": self.parameter, "message": self.message}


def again(words: str, options: str, *, imported: bool) -> str:
    """Return how to record again: in words, and with the options of `hil record` that do it.

    imported: whether a table of another program was imported. Its user has no such options, so that they are left out.
    """
    return words if imported else f"{words} ({options})"


def driven_by_position(*, is_error: bool, imported: bool = False) -> Diagnostic:
    """Return the diagnostic for motor torque that was read while the drive held positions.

    The Bc of the simulated joint comes out near zero then. is_error: for a result; a run to come is only warned of.
    imported: as `again`.
    """
    chirp = again("Drive a chirp of torque", "--mode torque --profile chirp", imported=imported)
    return Diagnostic(
        "motor-side",
        "the torque is the motor's, and its drive held positions. Between two ticks the drive's own loop changes the "
        "torque, and the readings do not show it. Kc is nearly right, but Bc is not that of the joint "
        f"(docs/position_loop.md). {chirp}, or record with a torque cell at the joint",
        "Bc",
        is_error=is_error,
    )


_MANY_LATE, _MOSTLY_LATE = 0.01, 0.1  # share of ticks that began more than half a period after their time


def lateness(late: int, samples: int) -> list[Diagnostic]:
    """Return the diagnostic for a run with `late` of `samples` ticks late: a warning above 1 %, an error above 10 %."""
    share = late / samples if samples else 0.0
    if share <= _MANY_LATE:
        return []
    return [
        Diagnostic(
            "many-late",
            f"{share:.1%} of the ticks came more than half a period late, so the motor did not follow the profile. "
            "Lower --rate, or close other programs",
            is_error=share > _MOSTLY_LATE,
        )
    ]
