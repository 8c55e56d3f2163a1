"""Recordings side by side: their repeatability, against recordings with a known variance between them."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ga.model.coupling import parse as parse_model
from hil.diagnostics import Diagnostic
from hil.errors import WrongUse
from hil.exchange.importer import Column, import_table
from hil.exchange.row_filter import RowFilter
from hil.identification import compare as comparison
from hil.identification.compare import Measured, Repeated, compare
from hil.identification.identify import identify_sources
from hil.identification.result import Estimate, Repeatability, standard_error, with_scale
from hil.identification.same_stand import same_stand_diagnostics
from hil.recording.channels import TorqueScale
from hil.report.comparison import as_json, comparison_section
from hil.signals.source import open_sources

from ..conftest import Hil, Maker, edited
from .conftest import SEARCH

STAND = '[stand]\nname = "finger"\ngear_ratio = 4.0\n[limits]\ntorque = 0.03\ndeflection = 1.0\nvelocity = 100.0\n'


def stamped(path: Path, hour: float = 0.0, stand: str = "", kind: str = "chirp") -> Path:
    """The same recording with another time, stand and kind of profile."""
    minutes = round(60 * hour)
    with edited(path) as file:
        file.attrs["created"] = f"2026-05-04T{10 + minutes // 60:02d}:{minutes % 60:02d}:00+00:00"
        file.attrs["stand_toml"] = stand
        file["profile"].attrs["kind"] = kind
    return path


def estimate(value: float, half: float) -> Estimate:
    trials = Repeatability(value, value, 0.0)
    return Estimate("Kc", "N*m/rad", value, (value - half, value + half), trials, True, None, (0.0, 99.0))


def repeated(stiffness: list[float], error: float = 1e-6, scale: float = 0.0) -> Repeated:
    """Kc of recordings an hour apart, each with that standard error and an uncertain torque, relative."""
    measured = []
    for hour, kc in enumerate(stiffness):
        found = {"Kc": with_scale(estimate(kc, 1.959964 * error), scale)}
        common = TorqueScale(scale, "the stand")
        measured.append(Measured(Path(f"{hour}.h5"), None, float(hour), "linear", found, frozenset(found), common))
    return comparison._repeated("Kc", measured)


def test_recordings_of_the_same_coupling_are_said_to_agree(make_recording: Maker) -> None:
    each = [make_recording(f"r{at}.h5", samples=600, noise=1e-5, seed=at) for at in range(3)]
    found = compare([stamped(path, float(at)) for at, path in enumerate(each)], parse_model("linear"), SEARCH)
    kc, bc = found.parameters
    assert kc.pooled is not None
    assert kc.pooled.ci95[0] < 0.02 < kc.pooled.ci95[1]
    assert (kc.repeats, bc.repeats) == (True, True)
    assert kc.verdict.startswith(("Kc repeats:", "Kc agrees"))
    assert found.trustworthy
    said = json.loads(json.dumps(as_json(found)))
    assert said["schema"] == "hil-comparison/2"
    pooled = said["parameters"]["Kc"]
    assert pooled["ci95"][0] < 0.02 < pooled["ci95"][1]
    assert pooled["between_ci95"][0] <= pooled["between"] <= pooled["between_ci95"][1]
    assert set(pooled["drift_per_hour"]) == {"value", "ci95", "p"}
    assert [one["hours"] for one in said["recordings"]] == [0.0, 1.0, 2.0]
    assert said["recordings"][0]["parameters"]["Bc"]["unit"] == "N*m*s/rad"
    assert said["verdict"] == [kc.verdict, bc.verdict]


def test_a_variance_between_recordings_is_estimated_and_stated_in_words() -> None:
    put_in = np.array([0.0, 3e-4, -4e-4, 5e-4, -2e-4, 1e-4])
    kc = repeated(list(0.02 + put_in))
    assert kc.pooled is not None
    assert kc.pooled.between == pytest.approx(np.std(put_in, ddof=1), rel=1e-4)
    assert kc.pooled.within == pytest.approx(1e-6, rel=1e-3)
    assert kc.repeats is False
    assert "Kc does not repeat: the recordings differ by 1.6 %" in kc.verdict
    assert "drifts" not in kc.verdict


def test_an_uncertain_torque_hides_no_difference_and_is_in_the_pooled_interval() -> None:
    put_in = [0.02, 0.0203, 0.0196, 0.0205]
    before, after = (repeated(put_in, scale=scale) for scale in (0.0, 0.05))
    assert before.pooled is not None
    assert after.pooled is not None
    assert after.pooled.value == pytest.approx(before.pooled.value)
    assert after.pooled.between == pytest.approx(before.pooled.between, rel=1e-3)
    assert after.pooled.within == pytest.approx(before.pooled.within, rel=1e-3)
    assert after.repeats == before.repeats
    low, high = before.pooled.ci95
    half = math.hypot(0.5 * (high - low), 1.959964 * 0.05 * before.pooled.value)
    assert after.pooled.ci95 == pytest.approx((after.pooled.value - half, after.pooled.value + half), rel=1e-4)


@pytest.mark.parametrize(("doubted", "compared"), [("Kc", {"Bc"}), ("Bc", {"Kc"}), (None, set())])
def test_a_parameter_with_an_error_is_not_compared(
    make_recording: Maker, doubted: str | None, compared: set[str]
) -> None:
    doubt = Diagnostic("unusable", "-", doubted, is_error=True)
    with open_sources([make_recording("a.h5", samples=600, noise=1e-5)]) as sources:
        found = replace(identify_sources(sources, parse_model("linear"), SEARCH), diagnostics=(doubt,))
        assert comparison._measured(sources[0], None, 0.0, None, found).identifiable == compared


@pytest.mark.study
def test_an_uncertain_torque_is_said_to_be_the_same_in_all_recordings(make_recording: Maker) -> None:
    stand = STAND.replace("[limits]", "torque_uncertainty = 0.06\n[limits]")
    each = [make_recording(f"{at}.h5", samples=600, noise=1e-5, seed=at) for at in range(2)]
    paths = [stamped(path, float(at), stand, "imported") for at, path in enumerate(each)]
    found = compare(paths, parse_model("linear"), SEARCH)
    assert [one.created for one in found.recordings] == [None] * 2  # the hour of an import is not that of the run
    said = [one.message for one in found.diagnostics if one.code in {"hard-to-compare", "wide-interval"}]
    assert sum("no drift is estimated" in one for one in said) == 1
    assert sum("uncertain by 12% because the torque's scale is" in one for one in said) == 1
    assert "the same in all recordings; only the pooled intervals include it" in comparison_section(found).lines[0]
    assert found.parameters[0].drift is None  # of two


def test_a_drift_is_found_by_the_recordings_own_times() -> None:
    """2 % an hour was put in."""
    kc = repeated([0.02, 0.0204, 0.0208, 0.0212])
    assert kc.drift is not None
    assert kc.drift.slope == pytest.approx(4e-4, rel=1e-3)
    assert kc.drift.p < 0.01
    assert "It drifts by +1.9 % an hour" in kc.verdict


def test_recordings_that_agree_more_closely_than_their_errors_are_said_to() -> None:
    assert repeated([0.02] * 3, error=1e-4).verdict.startswith(
        "Kc repeats: the recordings differ by less than their own errors of 0.5 % predict"
    )


@pytest.mark.study
def test_a_recording_that_cannot_tell_a_parameter_is_left_out_of_it(make_recording: Maker) -> None:
    def still(channels: dict[str, Any]) -> None:
        channels["dtheta"][:] = 0.1

    good = [stamped(make_recording(f"{name}.h5", samples=600, noise=1e-5, seed=seed)) for seed, name in enumerate("ab")]
    paths = [*good, stamped(make_recording("c.h5", samples=600, change=still))]
    found = compare(paths, parse_model("linear"), SEARCH)
    assert found.parameters[0].recordings == tuple(good)
    assert found.recordings[2].estimates == {}
    assert any(one.code == "hard-to-compare" and "it is left out" in one.message for one in found.diagnostics)
    assert found.trustworthy
    alone = compare(paths[1:], parse_model("linear"), SEARCH)
    assert not alone.trustworthy
    assert alone.parameters[0].repeats is None
    assert "1 of 2 recordings identify it" in alone.parameters[0].verdict


@pytest.mark.study
def test_the_real_runs_of_one_actuator_agree(tmp_path: Path, locked_output: Path) -> None:
    """Two ramps of split_runin1 of +-25 to 40 N m, whose friction is a term of its own."""
    columns = {"time": Column("TIME", "s"), "torque": Column("TORQUE", "N*m"), "dtheta": Column("POSITION", "rev")}
    paths = [tmp_path / f"{run}.h5" for run in (100, 101)]
    for path in paths:
        where = [RowFilter.parse(f"test_nr=={path.stem}")]
        import_table(locked_output / "split_runin1.csv.gz", path, columns, where)
    kc = compare(paths, parse_model("linear+offset+coulomb"), SEARCH).parameters[0]
    assert kc.pooled is not None
    assert 440.0 < kc.pooled.value < 480.0
    assert kc.pooled.between_ci95[0] < 0.1 * kc.pooled.value


@pytest.mark.parametrize(("half", "error"), [(1.959964, 1.0), (0.0, 2e-8), (math.inf, math.inf)])
def test_a_standard_error_is_the_intervals_and_never_zero(half: float, error: float) -> None:
    assert standard_error(estimate(20.0, half)) == pytest.approx(error)
    assert standard_error(replace(estimate(20.0, half), value=0.0, ci95=(0.0, 0.0))) > 0.0


# --- one stand -------------------------------------------------------------------------------------------------------


def check_together(paths: list[Path]) -> list[Diagnostic]:
    with open_sources(paths) as sources:
        return same_stand_diagnostics(sources)


def test_recordings_of_different_stands_are_refused(make_recording: Maker) -> None:
    first = stamped(make_recording("a.h5"), stand=STAND)
    second = stamped(make_recording("b.h5"), stand=STAND.replace("finger", "thumb"))
    with pytest.raises(WrongUse, match=r"b.h5 is of the stand 'thumb' and .*a.h5 of 'finger'"):
        check_together([first, second])


def test_a_stand_that_was_changed_between_two_recordings_is_said(make_recording: Maker) -> None:
    first = stamped(make_recording("a.h5"), stand=STAND)
    changed = STAND.replace("4.0", "5.0").replace("0.03", "0.05") + "[sim]\n"
    second, third = stamped(make_recording("b.h5"), stand=changed), stamped(make_recording("c.h5"))
    found = check_together([first, second, third])
    assert [diagnostic.code for diagnostic in found] == ["other-stand", "other-stand"]
    assert "gear_ratio 5.0 (not 4.0), limits.torque 0.05 (not 0.03)" in found[0].message
    assert "c.h5: no stand is named" in found[1].message


def test_recordings_of_one_stand_or_of_none_have_nothing_said_of_them(make_recording: Maker) -> None:
    one = [stamped(make_recording(f"{name}.h5"), stand=STAND) for name in "ab"]
    assert check_together(one) == []
    assert check_together([stamped(make_recording(f"{name}.h5")) for name in "cd"]) == []


def test_the_same_run_twice_is_refused(make_recording: Maker, tmp_path: Path) -> None:
    path = make_recording("a.h5")
    (tmp_path / "copy.h5").write_bytes(path.read_bytes())
    with pytest.raises(WrongUse, match=r"copy.h5 is the same run as"):
        check_together([path, tmp_path / "copy.h5"])


# --- the command -----------------------------------------------------------------------------------------------------


def test_the_command_prints_each_recording_what_they_share_and_a_verdict(hil: Hil, make_recording: Maker) -> None:
    for index, kc in enumerate([0.02, 0.021, 0.0205]):
        stamped(make_recording(f"r{index}.h5", samples=600, kc=kc, noise=1e-5, seed=index), hour=index / 2)
    status, out, err = hil(
        "compare", "r0.h5", "r1.h5", "r2.h5", "--model", "linear", "--trials", 1, "--workers", 1, "--report", "c.html"
    )
    assert status == 0
    assert all(name in out for name in ("r0.h5", "r1.h5", "r2.h5", "Kc, mN m/rad", "pooled", "within", "between"))
    assert "…" not in out  # nothing is cut off at 80 characters
    assert "Kc does not repeat" in out
    assert "wrote c.html\n" in err
    page = Path("c.html").read_text()
    assert "Kc does not repeat" in page
    assert re.search(r'<p class="answer">Kc = \S+ ± \S+ mN m/rad \(does not repeat\)</p>', page)
    assert re.search(r'<p class="answer">Bc = \S+ ± \S+ mN m s/rad \(3 recordings pooled\)</p>', page)


def test_a_comparison_nothing_can_be_said_of_ends_with_status_1(hil: Hil, make_recording: Maker) -> None:
    def still(channels: dict[str, Any]) -> None:
        channels["dtheta"][:] = 0.1

    for name in "ab":
        make_recording(f"{name}.h5", samples=100, change=still)
    status, out, err = hil("compare", "a.h5", "b.h5", "--trials", 1, "--json")
    assert status == 1
    assert json.loads(out)["parameters"]["Kc"]["value"] is None
    assert "error [hard-to-compare]: Kc cannot be compared: 0 of 2 recordings identify it" in err
