"""The report: the numbers people read are the ones that were found, in the unit beside them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ga.model.coupling import parse
from hil.errors import WrongUse
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.identification.result import Conditional, Identification, Step, VarianceComponents
from hil.report.html_page import check_page_name, table_lines
from hil.report.identification import (
    equation,
    estimates_section,
    headline,
    repeatability_section,
    summary_lines,
    truth_lines,
)
from hil.report.identification_json import as_json
from hil.report.identification_page import write_page
from hil.report.pictures.estimates import intervals_text
from hil.report.pictures.result import figure

from ..conftest import Maker
from .conftest import recording


@pytest.fixture(scope="module")
def rich(tmp_path_factory: pytest.TempPathFactory) -> Identification:
    path = recording(tmp_path_factory.mktemp("rich") / "a.h5", samples=1000)
    return identify([path], parse("linear+offset+drift+coulomb+cubic"), Search(trials=3, seed=0, workers=1))


def text(result: Identification) -> str:
    tables = (estimates_section(result), repeatability_section(result))
    return "\n".join(line for table in tables for line in (table.heading, *table_lines(table.rows)))


def test_a_page_states_the_model_as_an_equation_and_names_every_sign(rich: Identification, tmp_path: Path) -> None:
    page = write_page(rich, tmp_path / "r.html", force=True).read_text(encoding="utf-8")
    assert "tau = Kc*x + Bc*v + tau0 + drift*t + Fc*sign(v) + K3*x^3 (tau: torque at the joint; x: deflection" in page
    for parameter in rich.model.linear:
        assert f"<td>{parameter.meaning}</td>" in page
    assert "a spring Kc and a damper Bc in parallel; a constant torque" in page
    assert "Kc is its constant part, the factor of x in the model" in page  # the term cubic changes the stiffness
    assert equation(parse("linear+skew")).startswith("tau = Kc*x + Bc*v; x and v are those of the time t - skew (")


def test_a_page_says_why_the_average_is_not_the_optimum_where_either_stands(
    found: Identification, tmp_path: Path
) -> None:
    kc = replace(found["Kc"], conditional=Conditional(1.01 * found["Kc"].value, found["Kc"].ci95))
    step = Step("linear", "linear", 1.0, 1.0, 1.0, 1.0, 1.0, included=True, cost=0.0)
    averaged = replace(found, estimates=(kc, found["Bc"]), steps=(step,))
    exact = "averaged over the models that the data cannot decide between: the exact optimum of linear alone is Kc"
    page = write_page(averaged, tmp_path / "r.html", force=True).read_text(encoding="utf-8")
    assert page.count(f"{exact} {1e3 * kc.exact:.5g} mN m/rad") == 2  # beside the numbers, and beside the optimum
    assert exact not in write_page(found, tmp_path / "s.html", force=True).read_text(encoding="utf-8")


@pytest.mark.parametrize(("unexplained", "said"), [(0.0, "found no relevant misfit"), (0.5, "found a misfit")])
def test_the_first_page_says_whether_the_model_describes_the_recording(
    found: Identification, tmp_path: Path, unexplained: float, said: str
) -> None:
    assert found.lack_of_fit is not None
    tested = replace(found, lack_of_fit=replace(found.lack_of_fit, unexplained=unexplained))
    page = write_page(tested, tmp_path / "r.html", force=True).read_text(encoding="utf-8")
    assert f"<p>the lack-of-fit tests {said}" in page.partition("<details")[0]


def test_pooled_recordings_say_why_their_interval_is_what_it_is(found: Identification) -> None:
    apart = VarianceComponents(1e-5, 5e-4, (0.02, 0.021), 0.01)
    alike = VarianceComponents(1e-5, 0.0, (0.02, 0.02), 0.9)
    estimates = replace(found["Kc"], components=apart), replace(found["Bc"], components=alike)
    pooled = replace(found, recordings=2 * found.recordings, windows=(None, None), estimates=estimates)
    said = "\n".join(summary_lines(pooled))
    assert (
        "differs from recording to recording by 0.5 mN m/rad (standard deviation), which its interval includes" in said
    )
    assert "Bc of 2 pooled recordings differs from recording to recording by no more than their own errors" in said


@pytest.mark.parametrize(("kc", "factor", "unit"), [(0.02, 1e3, "mN m"), (20.0, 1.0, "N m")])
def test_a_page_says_value_interval_and_unit_as_they_were_found(
    found: Identification, make_recording: Maker, tmp_path: Path, *, kc: float, factor: float, unit: str
) -> None:
    """A hand's joint is spoken of in mN m, as in the paper; an arm's is not."""
    result = found
    if kc > 1.0:
        path = make_recording(samples=800, kc=kc, bc=kc / 100.0, noise=kc / 100.0)
        result = identify([path], parse("linear"), Search(trials=1, seed=0, workers=1))
    page = write_page(result, tmp_path / "a.html", force=True).read_text()
    pattern = r'<tr><th scope="row">(\w+)</th><td>(\S+)</td><td>(\S+) to (\S+)</td><td>([^<]+)</td><td>'
    rows = re.findall(pattern, page)
    assert [(name, said) for name, _, _, _, said in rows] == [("Kc", f"{unit}/rad"), ("Bc", f"{unit} s/rad")]
    for name, *numbers, _ in rows:
        estimate = result[name]
        expected = [estimate.value * factor, estimate.ci95[0] * factor, estimate.ci95[1] * factor]
        half = 0.5 * (expected[2] - expected[1])
        assert [float(number) for number in numbers] == pytest.approx(expected, abs=0.5 * half)
        assert [float(number) for number in numbers[1:]] == pytest.approx(expected[1:], abs=0.05 * half)
    assert float(rows[0][1]) == pytest.approx(kc * factor, rel=0.02)


def test_the_picture_shows_the_torque_the_model_and_the_residuals(found: Identification) -> None:
    result = found
    axes = figure(result).axes
    signals = result.signals
    model = result["Kc"].value * signals.motion.dtheta + result["Bc"].value * signals.motion.dtheta_dot
    lines = [(panel.get_xlabel(), [np.asarray(line.get_xydata()) for line in panel.get_lines()]) for panel in axes]
    over_time = [found for label, found in lines if label in {"", "time [s]"}]
    (loop,) = [found for label, found in lines if label == "deflection [rad]"]
    for shown, x, y in [
        (over_time[0][0], signals.motion.time, signals.torque),
        (over_time[0][1], signals.motion.time, model),
        (over_time[1][0], signals.motion.time, signals.torque - model),
        (loop[0], signals.motion.dtheta, signals.torque),
        (loop[1], signals.motion.dtheta, model),
    ]:
        np.testing.assert_allclose(shown, np.column_stack([x, y * 1e3]), atol=1e-12)


@pytest.mark.study
def test_pooled_recordings_are_not_joined_by_a_line(make_recording: Maker) -> None:
    paths = [make_recording(f"{seed}.h5", samples=400, noise=2e-4, seed=seed) for seed in range(2)]
    result = identify(paths, parse("linear"), Search(trials=1, seed=0, workers=1))
    for panel in figure(result).axes[:3]:  # those over time, and the loop
        for line in panel.get_lines():
            breaks = np.flatnonzero(np.isnan(np.asarray(line.get_xydata())).any(axis=1))
            np.testing.assert_array_equal(breaks, result.signals.motion.starts[1:])


def test_the_pictures_title_has_the_value_and_half_the_interval(found: Identification) -> None:
    result = found
    shown = r"Kc = (\S+) ± (\S+) mN m/rad,  Bc = (\S+) ± (\S+) mN m s/rad  \(95 %\)"
    match = re.fullmatch(shown, figure(result).get_suptitle())
    assert match is not None
    for index, name in enumerate(("Kc", "Bc")):
        estimate = result[name]
        half = 0.5e3 * (estimate.ci95[1] - estimate.ci95[0])
        assert float(match[2 * index + 1]) == pytest.approx(estimate.value * 1e3, abs=half)
        assert float(match[2 * index + 2]) == pytest.approx(half, rel=0.5)  # one digit is said
        assert match[2 * index + 2] == f"{half:.1g}"


@pytest.mark.filterwarnings("ignore:invalid value encountered in sqrt")  # of an interval that is not identifiable
def test_the_tables_hold_every_value_and_interval(rich: Identification) -> None:
    result = rich
    shown = text(result)
    for estimate in result.estimates:
        assert f"{estimate.value * 1e3:.5g}" in shown
        assert f"± {estimate.optimiser.std * 1e3:.0e}" in shown
    low, high = (float(end) for end in re.findall(r"(\S+) to (\S+) +mN m/rad", shown)[0])
    assert (low, high) == pytest.approx([end * 1e3 for end in result["Kc"].ci95], rel=1e-3)


def test_a_parameter_that_is_not_identifiable_is_said_to_be_in_every_place(found: Identification) -> None:
    result = found
    kc, bc = result.estimates
    doubted = replace(result, estimates=(kc, replace(bc, identifiable=False)))
    assert "Bc (not identifiable)" in text(doubted)
    assert "(not identifiable)" not in text(result) + headline(result)
    assert headline(doubted).endswith("mN m s/rad (not identifiable)")


def test_a_stiffness_that_depends_on_the_amplitude_is_a_range_and_has_no_value(found: Identification) -> None:
    result = found
    kc, bc = result.estimates
    wide = replace(kc, value=0.6, ci95=(0.48, 0.72), depends_on="amplitude", identifiable=False)
    spans = replace(result, estimates=(wide, bc))
    first = headline(spans).split(",  ")[0]
    assert first == "Kc = 480 to 720 mN m/rad (depends on the amplitude)"
    assert "600" not in text(spans).split("optimiser")[0]
    assert as_json(spans)["parameters"]["Kc"]["depends_on"] == "amplitude"
    assert as_json(result)["parameters"]["Kc"]["depends_on"] is None


@pytest.mark.filterwarnings("ignore:invalid value encountered in sqrt")
def test_the_summary_names_every_other_parameter_and_the_fit(rich: Identification) -> None:
    result = rich
    model, fit, work = summary_lines(result)
    assert model.startswith("model linear+offset+drift+coulomb+cubic: tau0 = ")
    assert ",  drift = " in model
    assert f"{result.optimum * 1e3:.3g} mN m over {result.samples} samples" in fit
    assert f"{result.validation.nrmse:.2%}" in fit
    assert f"{result.trials.evaluations} evaluations" in work


def test_a_small_inertia_is_printed_with_a_power_of_a_thousand(found: Identification) -> None:
    inertia = replace(found["Kc"], name="J", unit="kg*m^2", value=2.012e-5, ci95=(2.006e-5, 2.018e-5))
    heavy = replace(found, estimates=(*found.estimates, inertia))
    assert "J = 20.12e-6 ± 0.06e-6 kg m^2" in summary_lines(heavy)[0]


def test_no_unit_is_printed_after_a_pure_number(found: Identification, tmp_path: Path) -> None:
    rubs = replace(found["Kc"], name="mu", unit="1", value=0.18, ci95=(0.16, 0.2))
    result = replace(found, estimates=(*found.estimates, rubs))
    unit_of_one = re.compile(r"mu\b[^;,|]*\d 1\b|\[1\]")
    page = write_page(result, tmp_path / "a.html", force=False).read_text()
    for said in (*summary_lines(result), intervals_text(result), text(result)):
        assert not unit_of_one.search(said)
    assert summary_lines(result)[0].endswith("mu = 0.18 ± 0.02")
    assert re.search(r"mu = 0\.1\d+ ± [^ ]+ 1\b", page) is None
    assert as_json(result)["parameters"]["mu"]["unit"] == "1"


def test_the_truth_of_a_simulated_joint_is_held_against_the_interval(found: Identification) -> None:
    result = found
    (low, high), (first, _) = result["Kc"].ci95, result["Bc"].ci95
    kc, bc = truth_lines(result, {"Kc": 0.5 * (low + high), "Bc": 0.99 * first, "Fc": 0.0})
    assert kc.startswith(f"true Kc of the simulated joint: {0.5e3 * (low + high):.5g} mN m/rad")
    assert kc.endswith("holds it")
    assert "does not hold" not in kc
    assert bc.endswith("does not hold it")


def test_one_trial_has_a_mean_and_no_standard_deviation(make_recording: Maker) -> None:
    path = make_recording(samples=400, noise=2e-4)
    shown = text(identify([path], parse("linear"), Search(trials=1, seed=0, workers=1)))
    assert "nan" not in shown
    assert "±" not in shown.replace("mean ± std", "")


def test_a_report_whose_name_says_another_format_is_refused(tmp_path: Path) -> None:
    assert check_page_name(tmp_path / "a.HTML") == tmp_path / "a.HTML"
    with pytest.raises(WrongUse, match=r"a\.png is no name of a report.* a\.html|a\.html"):
        check_page_name(tmp_path / "a.png")


def test_a_report_that_cannot_be_drawn_leaves_the_old_one(
    found: Identification, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "p.html").write_text("the old one")

    def fail(*_words: Any, **_settings: Any) -> None:
        raise MemoryError

    monkeypatch.setattr("hil.report.html_page.library", fail)
    with pytest.raises(MemoryError):
        write_page(found, tmp_path / "p.html", force=True)
    assert [item.name for item in tmp_path.iterdir()] == ["p.html"]
    assert (tmp_path / "p.html").read_text() == "the old one"
