"""What is said of terms that a recording neither asks for nor rules out."""

from __future__ import annotations

from hil.judgement import rivals
from hil.ladder import Rung
from hil.result import Estimate


def rung(term: str, bc: float, fitness: float = 1e-4, *, taken: bool = False) -> Rung:
    return Rung(f"linear+{term}", term, fitness, fitness, -5.0, 0.02, bc, taken)


def estimate(name: str, exact: float, half: float) -> Estimate:
    return Estimate(name, "", exact, exact, (exact - half, exact + half), exact, 0.0, True, None, (0.0, 1.0))


FOUND = (estimate("Kc", 0.02, 1e-5), estimate("Bc", 2e-4, 1e-6))
CHOSEN = rung("linear", 2e-4, taken=True)


def test_a_term_that_would_move_a_parameter_out_of_its_interval_is_named() -> None:
    (finding,) = rivals((CHOSEN, rung("skew", 2.1e-4)), FOUND)
    assert (finding.code, finding.parameter, finding.fatal) == ("model-dependent", "Bc", False)
    assert "with skew" in finding.message
    assert "+5.00%" in finding.message


def test_a_term_that_moves_nothing_or_fits_worse_is_not() -> None:
    assert not rivals((CHOSEN, rung("skew", 2.005e-4), rung("slack", 3e-4, fitness=1.1e-4)), FOUND)
