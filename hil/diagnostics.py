"""Diagnostics: the warnings and errors about a recording, a run or a result, each with a code and a remedy."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """A warning or an error about a recording, a run or a result. After an error the result must not be trusted.

    code: a fixed name for scripts. message: what is wrong, what it means for Kc or Bc, and what to do. parameter: the
    affected parameter, None if all parameters are affected.
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
        """Return this diagnostic as an entry for the lists "warnings" and "errors" in every command's JSON."""
        return {"code": self.code, "parameter": self.parameter, "message": self.message}


def again(words: str, options: str, *, imported: bool) -> str:
    """Return the advice to record again: `words`, then the `options` of `hil record` for that.

    imported: whether the recording was imported from another program's table. Then the options are left out, because
    the user did not record with `hil record`.
    """
    return words if imported else f"{words} ({options})"


def driven_by_position(*, is_error: bool, imported: bool = False) -> Diagnostic:
    """Return the diagnostic for motor torque that was read while the drive held positions.

    In such a recording the Bc of the simulated joint is estimated near zero. is_error: True for a result, False for a
    warning before a run. imported: whether the recording was imported from another program's table.
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


def over_limit(exceeded: str) -> Diagnostic:
    """Return the error for a limit that a whole run exceeded. exceeded: which one, how far, and since when."""
    return Diagnostic(
        "over-limit",
        f"{exceeded}: the load was beyond what the stand file allows. If it changed the joint, Kc and Bc are not those "
        "of before. Check the joint, then record with a lower --amplitude, or correct [limits]",
        is_error=True,
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
