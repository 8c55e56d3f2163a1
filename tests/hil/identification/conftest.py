"""What the tests of the identification share."""

from __future__ import annotations

import pytest

from ga.model.coupling import parse
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.identification.result import Identification
from hil.recording.writer import Header, write

from ..conftest import closed_form

SEARCH = Search(trials=1, seed=0, workers=1)


@pytest.fixture(scope="session")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Identification:
    """A linear joint by the linear model: 0.02 N m/rad and 0.2 mN m s/rad, with 0.1 mN m of noise."""
    path = tmp_path_factory.mktemp("sound") / "a.h5"
    write(path, Header(profile={"kind": "imported"}, stand_toml=""), closed_form(noise=1e-4))
    return identify([path], parse("linear"), SEARCH)
