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
