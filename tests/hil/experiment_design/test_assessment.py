"""`hil design`: the errors it predicts, the excitation it finds, and the warnings about both."""

from __future__ import annotations

import itertools
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.servo import Quantity
from ga.lad.exact import least_absolute_deviations
from hil.acquisition import excitation
from hil.acquisition.run import run
from hil.cli.app import run as hil
from hil.errors import WrongUse
from hil.experiment_design.advice import of_profile, of_task
from hil.experiment_design.assessment import Assessment, Task, assess, rounded, task_of
from hil.experiment_design.fisher import Prediction
from hil.experiment_design.response import respond
from hil.experiment_design.search import best
from hil.signals.prepare import Signals, prepare
from hil.signals.source import open_sources
from hil.stand.file import SIMULATED, parse

REAL = SIMULATED.replace('backend = "sim"\n', "").replace("motor_inertia = 2.0e-7\n", "")


def task(model: str = "linear", *, text: str = SIMULATED, rate: float = 250.0, quantity: str = "torque") -> Task:
    return task_of(
        parse(text), kc=0.01775, bc=1.9e-4, torque_noise=None, model=model, mode=Quantity(quantity), rate=rate
    )


def judged(asked: Task, kind: str, band: tuple[float, float], amplitude: float, duration: float = 4.0) -> Assessment:
    return assess(
        asked,
        excitation.make(
            kind,
            asked.mode,
            amplitude=amplitude,
            default_amplitude=amplitude,
            duration=duration,
            band=band,
            rate=asked.rate,
            seed=1,
        ),
    )


def short(asked: Task, duration: float) -> Assessment:
    """A profile in the place of the best, whose search takes longer than all the rest."""
    return judged(asked, "sine", (5.0, 5.0), 1e-3, duration)


def signals_of(path: Path) -> Signals:
    with open_sources([path]) as (source,):
        return prepare(source.recording, source.table)


@pytest.mark.study
def test_the_predicted_errors_are_those_of_recordings_on_the_simulated_stand(tmp_path: Path) -> None:
    """Two dozen of 1.5 s; their spread is uncertain by 15 %. docs/design.md has 200 of each of six cases."""
    stand = parse(SIMULATED)
    made = judged(task(), "multisine", (2.0, 15.0), 0.008, 1.5)
    genes = []
    for seed in range(24):
        path, outcome = run(stand, made.profile, rate=250.0, seed=seed, output=tmp_path / "a.h5", force=True)
        assert outcome.error is None
        seen = signals_of(path)
        columns = np.stack([seen.motion.dtheta, seen.motion.dtheta_dot], axis=1)
        genes.append(least_absolute_deviations(columns, seen.coupling_torque).genes)
    predicted = [made["Kc"].error, made["Bc"].error]
    assert np.std(genes, axis=0, ddof=1) == pytest.approx(predicted, rel=0.35)


@pytest.mark.parametrize("quantity", ["torque", pytest.param("position", marks=pytest.mark.study)])
def test_the_best_excitation_beats_the_usual_one_and_keeps_every_limit(quantity: str) -> None:
    asked = task(quantity=quantity)
    usual = judged(asked, "chirp", (0.5, 15.0), 0.006 if quantity == "torque" else 0.2)
    found = best(asked, 4.0)
    assert found.relative < 0.7 * usual.relative
    assert 0.95 < max(found.worst_shares) <= 1.0
    for stiffer, thicker in itertools.product((0.8, 0.9, 1.1, 1.25), (0.67, 0.8, 1.2, 1.5)):
        other = replace(asked.joint, stiffness=0.01775 * stiffer, damping=1.9e-4 * thicker)
        assert max(asked.shares(respond(other, found.profile, asked.rate)[1])) < 1.01


@pytest.mark.study
def test_the_best_excitation_is_not_one_whose_bias_exceeds_its_standard_error() -> None:
    """Standard errors alone led to a PRBS up to 35.5 Hz: Bc 0.16 % +- 0.16, and 0.38 % of bias."""
    asked = task("auto", rate=500.0)
    variance_only = judged(asked, "prbs", (0.4, 35.5), 0.00672, 20.0)
    assert variance_only["Bc"].bias > 1.5 * variance_only["Bc"].error
    found = best(asked, 20.0)
    for parameter in (found["Kc"], found["Bc"]):
        assert abs(parameter.bias) < parameter.error
    assert found.relative < variance_only.relative


def test_a_relative_error_holds_the_bias_which_a_longer_run_does_not_reduce() -> None:
    one = Prediction("Bc", "N*m*s/rad", rough=2.0, error=0.03, bound=0.02, bias=-0.04, inflation=1.0)
    assert one.relative() == pytest.approx(0.025)
    assert one.relative(1e-9) == pytest.approx(0.02)


@pytest.mark.study
def test_no_chirp_or_multisine_nearby_has_smaller_errors_than_the_best() -> None:
    asked = task("linear+offset+coulomb")
    found = best(asked, 4.0)
    for kind, band in itertools.product(("chirp", "multisine"), ((0.5, 5.0), (0.5, 20.0), (2.0, 10.0), (4.0, 20.0))):
        other = judged(asked, kind, band, 1e-3)
        amplitude = rounded(1e-3 / max(other.worst_shares), down=True)
        assert judged(asked, kind, band, amplitude).relative > 0.97 * found.relative, (kind, band)


def test_the_errors_of_auto_are_at_least_those_of_every_model_it_considers() -> None:
    considered = [
        judged(task(model), "chirp", (0.5, 15.0), 0.006) for model in ("linear", "linear+offset+coulomb+skew")
    ]
    auto = judged(task("auto"), "chirp", (0.5, 15.0), 0.006)
    assert {"Fc", "K3", "skew", "drift"} < {parameter.name for parameter in auto.parameters}
    for one in considered:
        assert all(auto[parameter.name].error >= 0.999 * parameter.error for parameter in one.parameters)


@pytest.mark.study
def test_a_tighter_limit_is_the_one_that_limits() -> None:
    for name, before, after in (
        ("deflection", "deflection = 1.0", "deflection = 0.1"),
        ("torque", "torque = 0.03", "torque = 0.003"),
    ):
        assert best(task(text=SIMULATED.replace(before, after)), 0.5).limited_by in {name, f"drive {name}"}


@pytest.mark.study
def test_the_command_it_prints_records_without_passing_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert hil(["design", "--backend", "sim", "--duration", "2", "--rate", "250", "--json"]) == 0
    found: dict[str, Any] = json.loads(capfd.readouterr().out)
    assert found["schema"] == "hil-design/2"
    assert set(found["profiles"]) == {"given", "best"}
    chosen = found["profiles"]["best"]
    assert hil([*shlex.split(chosen["command"])[1:], "-o", "a.h5"]) == 0
    reached = float(np.abs(signals_of(Path("a.h5")).motion.dtheta).max())
    assert reached == pytest.approx(chosen["limits"]["deflection"]["peak"], rel=0.02)


def test_the_table_names_both_profiles_their_errors_and_what_limits_them(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.api.planning.best", lambda asked, duration, _: short(asked, duration))
    words = ["design", "--backend", "sim", "--duration", "60", "--rate", "250", "--profile", "sine", "--band", "2"]
    assert hil([*words, "--model", "linear"]) == 0
    out, err = capfd.readouterr()
    for text in (
        "given: sine 2 Hz",
        "best: ",
        "mN m s/rad",
        "%",
        "of the limit of deflection (",
        "hil record --backend sim",
    ):
        assert text in out
    for code in ("corner-outside-band", "hidden-friction", "friction-in-damping"):
        assert f"[{code}]" in err


def codes(asked: Task, made: Assessment) -> dict[str, str | None]:
    return {diagnostic.code: diagnostic.parameter for diagnostic in of_profile(asked, made)}


def test_a_band_above_the_corner_is_warned_to_weaken_the_stiffness() -> None:
    asked = task(rate=1000.0)
    assert codes(asked, judged(asked, "chirp", (20.0, 90.0), 0.002))["corner-outside-band"] == "Kc"
    assert "corner-outside-band" not in codes(asked, judged(asked, "chirp", (1.0, 90.0), 0.002))


def test_an_amplitude_within_the_limits_only_for_these_rough_values_is_warned_of() -> None:
    asked = task()
    safe = judged(asked, "sine", (10.0, 10.0), 0.004)
    near = 0.004 * 0.99 / max(safe.shares)
    assert "near-limit" not in codes(asked, safe)
    assert "near-limit" in codes(asked, judged(asked, "sine", (10.0, 10.0), near))


def test_a_skew_of_the_readings_biases_until_the_model_has_it() -> None:
    late = SIMULATED + "\n[sim.sensors]\njoint_torque_delay = 0.002\n"
    for model, biased in (("linear", True), ("linear+skew", False)):
        asked = task(model, text=late, rate=500.0)
        assert ("biased" in codes(asked, judged(asked, "chirp", (0.5, 10.0), 0.004))) is biased


def test_an_excitation_too_weak_to_identify_the_damping_is_warned_of() -> None:
    asked = task()
    assert codes(asked, judged(asked, "ramp", (0.5, 0.5), 2e-4))["not-identifiable"] == "Bc"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--kc", "0"], "--kc 0: it must be above 0 N m/rad"),
        (["--torque-noise", "0"], "--torque-noise 0"),
        (["--band", "1:200"], "needs a rate of at least 800 Hz"),
        (["--amplitude", "0.02"], "lower --amplitude to 0.0"),
        (["--kc", "1e6"], "the limits permit no motion that the encoder resolves"),
        (["--model", "linear+backlash"], "the error of 'backlash' cannot be predicted"),
        (["--model", "linear+skew+inertia"], "leave one out"),
        (["--duration", "0.1"], "leave no band"),
    ],
)
def test_what_cannot_be_designed_is_refused_in_a_sentence(
    words: list[str], sentence: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert hil(["design", "--backend", "sim", "--rate", "500", "--duration", "3", *words]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert sentence in err
    assert "Traceback" not in err


def test_a_stand_that_is_not_simulated_needs_rough_values_and_says_what_it_assumes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("hil.api.planning.best", lambda asked, duration, _: short(asked, duration))
    path = tmp_path / "my stand.toml"
    path.write_text(REAL)
    words = ["design", "--stand", str(path), "--duration", "3", "--rate", "250", "--amplitude", "0.003"]
    assert hil(words) == 2
    assert "give --kc (N m/rad) and --bc (N m s/rad)" in capfd.readouterr().err
    assert hil([*words, "--kc", "0.02", "--bc", "2e-4"]) == 0
    out, err = capfd.readouterr()
    assert "[noise-assumed]" in err
    assert "[no-inertia]" in err
    assert f"--stand '{path}'" in out
    assert hil([*words, "--kc", "0.02", "--bc", "2e-4", "--torque-noise", "1e-4"]) == 0
    assert "[noise-assumed]" not in capfd.readouterr().err


@pytest.mark.parametrize(("quantity", "words"), [("torque", "half a tick (2 ms)"), ("position", "--mode torque")])
def test_torque_from_the_motors_side_is_warned_to_be_predicted_less_well(quantity: str, words: str) -> None:
    asked = task(text=SIMULATED.replace('"joint"', '"motor"'), quantity=quantity)
    (found,) = of_task(asked, noise_stated=True)
    assert found.code == "motor-side"
    assert words in found.message


def test_a_stand_without_limits_is_not_designed_for() -> None:
    with pytest.raises(WrongUse, match="sets no limits"):
        task(text='[stand]\nbackend = "sim"\n')


def test_the_commands_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hil.api.planning.best", lambda asked, duration, _: short(asked, duration))
    Path("stand.toml").write_text(REAL)
    page = (Path(__file__).parents[3] / "docs" / "design.md").read_text(encoding="utf-8")
    commands = re.findall(r"(?m)(?:^|`)(hil design --[^`\n]+)", page)
    assert len(commands) == 3
    for command in commands:
        assert hil(shlex.split(command)[1:]) == 0, capfd.readouterr().err
