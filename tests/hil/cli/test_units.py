"""Numbers with units on the command line: the same run as the same number in SI."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from drivers.servo import Quantity
from hil.cli import options
from hil.errors import WrongUse
from hil.recording.reader import Recording

from ..conftest import Hil

SIM = ("record", "--backend", "sim", "--fade", "0.2")


def test_a_run_with_units_is_the_run_in_si(hil: Hil, tmp_path: Path) -> None:
    units = ("--amplitude", "4 mN*m", "--band", "6:300 rpm", "--duration", "0.02 min", "--rate", "0.5 kHz")
    plain = ("--amplitude", "0.004", "--band", "0.1:5", "--duration", "1.2", "--rate", "500")
    for words, name in ((units, "a.h5"), (plain, "b.h5")):
        assert hil(*SIM, *words, "-o", name)[0] == 0
    with Recording(tmp_path / "a.h5") as first, Recording(tmp_path / "b.h5") as second:
        for name in ("time", "command"):
            assert first.channel(name) == pytest.approx(second.channel(name), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--amplitude", "5 deg"), "--mode torque takes torques; or record with --mode position"),
        (("--mode", "position", "--amplitude", "5 mNm"), "--mode position takes angles; or record with --mode torque"),
        (("--amplitude", "5 V"), "--amplitude '5 V': 'V' is not a unit of torque or angle"),
        (("--duration", "2 m"), "--duration '2 m': 'm' is not a unit of time"),
        (("--duration", "soon"), "--duration 'soon' is not a number"),
        (("--rate", "nan"), "--rate 'nan' is not a number"),
        (("--band", "1:2 V"), "--band '1:2 V': write LOW:HIGH in Hz"),
    ],
)
def test_another_unit_is_refused_with_the_option(hil: Hil, tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    status, out, err = hil(*SIM, *words, "-o", "a.h5")
    assert (status, out) == (2, "")
    assert said in err
    assert list(tmp_path.iterdir()) == []


def test_the_unit_of_a_span_may_stand_at_its_end(hil: Hil) -> None:
    assert options.span_of("10:30mN*m/rad", "stiffness") == pytest.approx([0.01, 0.03])
    assert options.span_of("1e-2:3e1 mNm/rad", "stiffness") == pytest.approx([1e-5, 0.03])
    assert options.span_of("10mN*m/rad:1N*m/rad", "stiffness") == pytest.approx([0.01, 1.0])
    assert options.span_of("0.1:5", "stiffness") == [0.1, 5.0]
    with pytest.raises(WrongUse):
        options.span_of("1", "stiffness")
    status, _, err = hil("identify", "a.h5", "--bounds", "Kc=10:30mN*m")
    assert (status, "write NAME=LOW:HIGH in SI" in err) == (2, True)


def test_an_amplitude_is_of_the_mode() -> None:
    assert options.amplitude_of("90 deg", Quantity.POSITION) == pytest.approx(math.pi / 2.0)
    assert options.amplitude_of("0.3", Quantity.POSITION) == options.amplitude_of("0.3", Quantity.TORQUE) == 0.3
