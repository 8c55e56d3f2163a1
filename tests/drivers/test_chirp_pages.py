"""The tables that benchmarks/chirps.py writes name every drive, and no run that failed."""

from __future__ import annotations

import re
from pathlib import Path

from .conftest import benchmark

ROOT = Path(__file__).parents[2]


def rows(page: str, mark: str) -> dict[str, list[str]]:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    found = re.search(rf"<!-- {mark} -->\n(.+?)<!-- end of {mark} -->", text, re.DOTALL)
    assert found is not None
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in found[1].splitlines()[2:]]
    return {cells[0]: cells[1:] for cells in lines}


def percent(cell: str) -> list[float]:
    return [float(number) for number in re.findall(r"([-+]\d[\d.]*)%", cell)]


def test_the_tables_of_chirps_name_every_drive() -> None:
    chirps = benchmark("chirps")
    wires, positions = rows("compatibility.md", "chirps"), rows("position_loop.md", "measured")
    assert list(wires) == [bench.name for bench in chirps.benches()]
    assert list(positions) == [bench.name for bench in chirps.benches() if bench.position is not None]
    for kc, bc, reason in wires.values():
        assert (abs(percent(kc)[0]) <= 1.0 and abs(percent(bc)[0]) <= 3.0) == (reason == "within 1 % and 3 %")
    for chirp, skewed, ramp, torque in positions.values():
        assert len(percent(chirp)) == len(percent(skewed)) == len(percent(torque)) == 2
        assert len(percent(ramp)) == 1
        assert abs(percent(torque)[1]) <= 3.0


def test_the_truth_of_a_bench_is_two_springs_and_dampers_in_series() -> None:
    chirps = benchmark("chirps")
    bench = next(bench for bench in chirps.benches() if bench.name == "commander")
    kc, bc = bench.truth
    omega = 1e-3
    joint, held = complex(bench.kc, omega * bench.bc), complex(20.0, omega * 2e-3)
    series = joint * held / (joint + held)
    assert abs(series.real / kc - 1.0) < 1e-6
    assert abs(series.imag / omega / bc - 1.0) < 1e-6
