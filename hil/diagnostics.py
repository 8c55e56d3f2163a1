"""What is to be said about a recording or a result: a code for machines, a sentence with the remedy for people."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """One warning. parameter: the one it touches, None where it touches all. fatal: the result must not be trusted."""

    code: str
    message: str
    parameter: str | None = None
    fatal: bool = False

    def as_json(self) -> dict[str, str | None]:
        """What of it the JSON of every command shows."""
        return {"code": self.code, "parameter": self.parameter, "message": self.message}


def driven_by_position(*, fatal: bool) -> Finding:
    """What is to be said of torque read from the motor's side while its drive held positions.

    Bc of the simulated joint comes out near zero then. fatal: where a result is judged, and not a run to come.
    """
    return Finding(
        "motor-side",
        "the torque is the motor's and its drive held positions: between two ticks the drive's own loop moves the "
        "torque, which the readings do not show, and Bc is not the joint's; record with --quantity torque, or with a "
        "torque cell at the joint",
        "Bc",
        fatal=fatal,
    )


_MANY_LATE, _MOSTLY_LATE = 0.01, 0.1  # share of ticks that began more than half a period after their time


def lateness(late: int, samples: int) -> list[Finding]:
    """What is to be said of a run of which `late` ticks of `samples` came late; fatal above a tenth."""
    share = late / samples if samples else 0.0
    if share <= _MANY_LATE:
        return []
    return [
        Finding(
            "many-late",
            f"{share:.1%} of the ticks came more than half a period late, so the motor was not driven as the profile "
            "says: lower --rate, or free the computer of other work",
            fatal=share > _MOSTLY_LATE,
        )
    ]
