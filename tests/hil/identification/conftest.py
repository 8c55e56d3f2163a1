"""What the tests of the identification share."""

from __future__ import annotations

from hil.identification.fitting.solution import Search

SEARCH = Search(trials=1, seed=0, workers=1)
