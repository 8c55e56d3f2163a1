"""`import hil`: light to import, the same numbers as the command line, and results that show and write themselves."""

from __future__ import annotations

import json
import math
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pint
import pytest

import hil as api
from hil.acquisition.limits import LimitReached
from hil.api.wording import in_python, on_the_command_line
from hil.diagnostics import Diagnostic
from hil.recording.reader import Recording
from hil.recording.writer import Header, write

from .conftest import Hil, Maker


def test_every_public_name_is_there_and_says_what_it_is() -> None:
    for name in api.__all__:
        assert getattr(api, name).__doc__
    assert dir(api) == api.__all__
    with pytest.raises(AttributeError, match=r"no attribute 'identfy'; it has .*identify"):
        api.identfy  # noqa: B018


def test_a_simulated_run_is_identified_as_the_command_line_does(hil: Hil) -> None:
    run = api.simulate("a.h5", duration=1.0, fade=0.2, seed=1)
    assert hil("record", "--backend", "sim", "--duration", 1, "--fade", 0.2, "--seed", 1, "-o", "b.h5").status == 0
    with Recording(Path("a.h5")) as one, Recording(Path("b.h5")) as other:
        assert one.attributes["sha256"] == other.attributes["sha256"]
    table = api.identify(run, "linear", trials=2).as_json()
    same = hil("identify", "a.h5", "--model", "linear", "--trials", 2, "--json").json
    for found in (table, same):
        found.pop("seconds")
    assert table == same


@pytest.mark.study
def test_the_parameters_of_the_simulator_are_those_that_were_given(tmp_path: Path) -> None:
    run = api.simulate(tmp_path / "a.h5", sim={"coupling": {"stiffness": 0.03, "damping": 3e-4}}, duration=3.0)
    loaded = run.load()
    assert (loaded.truth["Kc"], loaded.truth["Bc"]) == (0.03, 3e-4)
    result = api.identify(loaded.path, "linear+offset", trials=1)
    assert result["Kc"].value == pytest.approx(0.03, rel=0.02)
    with pytest.raises(api.WrongUse, match=r"sim\.coupling\.stifness: no such key"):
        api.simulate(tmp_path / "b.h5", sim={"coupling": {"stifness": 0.03}})
    assert not (tmp_path / "b.h5").exists()


def test_a_run_outside_the_main_thread_is_refused_with_the_reason(tmp_path: Path) -> None:
    with ThreadPoolExecutor(1) as pool, pytest.raises(api.WrongUse, match="outside the main thread, where Python"):
        pool.submit(api.simulate, tmp_path / "a.h5").result()
    assert list(tmp_path.iterdir()) == []


def test_a_loaded_recording_has_every_channel_with_its_unit(make_recording: Maker) -> None:
    path = make_recording(samples=100)
    loaded = api.load(path)
    with Recording(path) as recording:
        for name, values in loaded.channels.items():
            np.testing.assert_array_equal(values, recording.channel(name))
    assert (len(loaded), loaded.units["torque"], loaded.units["dtheta"]) == (100, "N*m", "rad")
    assert set(loaded.units) == set(loaded.descriptions) == set(loaded.channels)
    with pytest.raises(KeyError, match=r"no channel 'torq'; there are .*torque"):
        loaded["torq"]


def test_the_command_has_the_unit_of_its_mode(tmp_path: Path) -> None:
    for mode, unit in (("torque", "N*m"), ("position", "rad")):
        run = api.simulate(tmp_path / f"{mode}.h5", mode=mode, duration=1.0, fade=0.2)
        assert run.load().units["command"] == unit
    with pytest.raises(api.WrongUse, match=r"^`mode` 'speed': it is torque or position"):
        api.simulate(tmp_path / "c.h5", mode="speed")


def test_statistics_of_a_recording_leave_lost_rows_out(make_recording: Maker) -> None:
    path = make_recording(noise=2e-4, samples=600, change=lambda channels: channels["torque"].__setitem__(7, math.nan))
    loaded = api.load(path)
    known = np.delete(np.asarray(loaded["torque"]), 7)
    assert float(loaded["torque"].std()) == pytest.approx(float(known.std()))
    assert math.isnan(loaded.filled["torque"][7])
    torque = np.ma.masked_greater(loaded["torque"], 0.003)  # the arrays of a user have their own masks
    arrays: dict[str, Any] = {"time": loaded["time"], "dtheta": loaded["dtheta"]}
    found = api.identify(model="linear", trials=1, torque=torque, **arrays)
    same = api.identify(model="linear", trials=1, torque=torque.filled(np.nan), **arrays)
    assert (found["Kc"].value, found.identification.samples) == (same["Kc"].value, same.identification.samples)


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ("unknown --preset 'x'", "unknown `preset` 'x'"),
        ("try --model linear+skew or dahl, or", "try `model` linear+skew or dahl, or"),
        ("name a --model without skew", "name a `model` without skew"),
        ("outside --bounds Kc=0.01:5: or", "outside `bounds` Kc=0.01:5: or"),
        ("from --from to --to, --band 0.1:15", "from `start` to `end`, `band` 0.1:15"),
        ("(--mode torque --profile chirp)", "(`mode` torque `profile` chirp)"),
        ("faults are of --backend sim; --torque-unit", "faults are of `stand` sim; `torque_unit`"),
        ("see --report, or --verbose", "see `result.report(path)`, or `result.dynamic_stiffness`"),
        ("add --realtime, or use --no-guardian", "add `realtime=True`, or use `guardian=False`"),
        ("`hil record --force` replaces it", None),
        ("hil inspect measures --torque-noise", "hil inspect measures `torque_noise`"),
        ("run hil doctor --move, or hil identify a.h5 --model auto", None),
        ("import the table with --torque-scale -1", None),
    ],
)
def test_a_remedy_names_the_arguments_of_python_and_on_the_command_line_its_options(
    message: str, said: str | None
) -> None:
    assert in_python(message) == (said or message)
    with on_the_command_line():
        assert in_python(message) == message


def test_errors_and_warnings_of_functions_name_no_option(make_recording: Maker) -> None:
    path = make_recording(noise=2e-4, samples=600)
    for wrong in (
        lambda: api.identify(path, "nope"),
        lambda: api.identify(path, preset="nope"),
        lambda: api.identify(path, "linear", bounds={"Kd": (0.0, 1.0)}),
        lambda: api.compare(path),
        lambda: api.design("sim", model="nope"),
        lambda: api.simulate(path),
        lambda: api.simulate(rate=-1.0),
        lambda: api.identify(path, "linear", trials=1).report(path, force=False),
        lambda: api.hysteresis(path, torque="nope"),
    ):
        with pytest.raises((api.WrongUse, api.Untrustworthy)) as caught:
            wrong()
        assert "--" not in str(caught.value)
    found = api.identify(path, "linear", trials=1)
    doubt = Diagnostic("misfit", "leave a term out of --model", is_error=True)
    found = api.IdentificationResult(replace(found.identification, diagnostics=(doubt,)))
    assert found.diagnostics[0].message == "leave a term out of `model`"
    assert "error [misfit]: leave a term out of `model`" in found.summary()
    assert "--" not in found.summary()
    time = np.arange(600) / 500.0
    still = path.with_name("still.h5")
    write(still, Header(profile={"kind": "sine"}), {"time": time, "torque": np.sin(time), "dtheta": 0.0 * time})
    [left] = api.identify_each([still], "linear")
    assert "(`amplitude`)" in str(left)


@pytest.mark.study
def test_pandas_and_xarray_get_the_values_and_the_units(make_recording: Maker) -> None:
    loaded = api.load(make_recording(samples=100))
    frame = loaded.to_pandas()
    np.testing.assert_array_equal(frame["torque"].to_numpy(), loaded["torque"])
    np.testing.assert_array_equal(frame.index.to_numpy(), loaded["time"])
    assert frame.attrs["units"]["torque"] == "N*m"
    dataset = loaded.to_xarray()
    np.testing.assert_array_equal(dataset["dtheta"].to_numpy(), loaded["dtheta"])
    assert (dataset["dtheta"].dims, dataset["dtheta"].attrs["units"]) == (("time",), "rad")


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_without_an_optional_package_the_message_says_how_to_get_it(
    make_recording: Maker, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    loaded = api.load(make_recording(samples=100))
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(api.WrongUse, match=rf"{package} is not installed.*pip install {package}"):
        getattr(loaded, f"to_{package}")()


def test_results_show_the_answer_first_and_draw_and_write_themselves(make_recording: Maker, tmp_path: Path) -> None:
    result = api.identify([make_recording(noise=2e-4, samples=600)], "linear", trials=1)
    assert str(result).startswith("Kc")
    assert (result.model, result.trustworthy, result.interrupted) == ("linear", True, False)
    assert list(result.parameters) == ["Kc", "Bc"]
    assert result.dynamic_stiffness is result.identification.dynamic_stiffness
    assert result.plot().axes
    assert result.report(tmp_path / "r.html") == tmp_path / "r.html"
    assert (tmp_path / "r.html").is_file()
    assert api.load(result.identification.recordings[0]).plot().axes
    with pytest.raises(KeyError, match="no parameter 'Fc'; the model has Kc, Bc"):
        result["Fc"]


@pytest.mark.study
def test_arrays_and_quantities_give_what_the_recording_gives(make_recording: Maker) -> None:
    loaded = api.load(make_recording(noise=2e-4, samples=600))
    of_file = api.identify(loaded, "linear", trials=1)
    torque = pint.Quantity(1e3 * loaded["torque"], "mN*m")
    arrays = {"time": loaded["time"].tolist(), "dtheta": loaded["dtheta"], "dtheta_dot": loaded["dtheta_dot"]}
    found = api.identify(model="linear", trials=1, torque=torque, **arrays)
    assert found["Kc"].value == pytest.approx(of_file["Kc"].value, rel=1e-9)
    assert found["Bc"].ci95 == pytest.approx(of_file["Bc"].ci95, rel=1e-9)
    assert len(found.residuals) == len(found.predicted) <= 600
    assert float(np.mean(np.abs(found.residuals))) == pytest.approx(found.identification.optimum, rel=2e-3)
    assert found["Kc"].stderr == pytest.approx(found["Kc"].half_width / 1.959964)
    errors = np.sqrt(np.diag(found.covariance))
    assert errors == pytest.approx([one.stderr for one in found.parameters.values()])
    assert abs(found.covariance[0, 1]) < errors[0] * errors[1]
    assert f"{found}" in found.summary()
    assert "<td>Kc</td>" in found._repr_html_()


class Column(list[float]):
    def to_numpy(self) -> np.ndarray:
        return np.array(self)


class Frame(dict[str, Column]):
    """A data frame such as polars has: columns by name, without an index."""

    columns = property(list)
    shape = property(lambda self: (len(next(iter(self.values()))), len(self)))


def frame(path: Path, *, torque: str = "torque", scale: float = 1.0) -> Frame:
    loaded = api.load(path).filled
    columns = {"time": loaded["time"], "dtheta": loaded["dtheta"], torque: scale * loaded["torque"]}
    return Frame({name: Column(values) for name, values in columns.items()})


def test_a_data_frame_is_identified_by_its_headings_and_their_units(make_recording: Maker) -> None:
    path = make_recording(noise=2e-4, samples=600)
    wanted = api.identify(path, "linear", trials=1)
    found = api.identify(frame(path, torque="torque [mN*m]", scale=1e3), "linear", trials=1)
    assert found["Kc"].value == pytest.approx(wanted["Kc"].value, rel=1e-9)
    assert api.identify(path.read_bytes(), "linear", trials=1).digest == wanted.digest
    with pytest.raises(api.WrongUse, match=r"no column torque; it has time, dtheta, tau\. Rename columns"):
        api.identify(frame(path, torque="tau"))
    twice = Frame({**frame(path), "torque_Nm": frame(path)["torque"]})
    with pytest.raises(api.WrongUse, match="the columns torque, torque_Nm are all torque: keep one"):
        api.identify(twice)


def test_a_digest_changes_with_the_result_and_with_nothing_else(make_recording: Maker) -> None:
    first = api.identify(make_recording("a.h5", noise=2e-4, samples=600), "linear", trials=2, workers=1)
    again = api.identify(make_recording("b.h5", noise=2e-4, samples=600), "linear", trials=2, workers=2)
    others = [
        api.identify(make_recording("c.h5", noise=2e-4, samples=600, seed=1), "linear", trials=2),
        api.identify(make_recording("a.h5", noise=2e-4, samples=600), "linear", trials=3),
    ]
    assert first.digest == again.digest
    assert first.digest not in {one.digest for one in others}


def test_params_intervals_rows_and_predictions_are_named_as_in_statsmodels(make_recording: Maker) -> None:
    path = make_recording(
        noise=2e-4, samples=600, change=lambda channels: channels["torque"].__setitem__(300, math.nan)
    )
    result = api.identify(path, "linear", trials=1)
    assert result.params == {name: one.value for name, one in result.parameters.items()}
    assert result.conf_int() == {"Kc": result["Kc"].ci95, "Bc": result["Bc"].ci95}
    assert 300 not in result.rows
    torque = np.asarray(api.load(path)["torque"])[result.rows]
    np.testing.assert_allclose(torque, result.predicted + result.residuals)
    np.testing.assert_array_equal(result.predict(), result.predicted)
    other = make_recording("b.h5", samples=600, kc=0.02 + 1e-9)
    expected = np.asarray(api.load(other)["torque"])[api.identify(other, "linear", trials=1).rows]
    np.testing.assert_allclose(result.predict(other), expected, atol=1e-4)


@pytest.mark.study
def test_a_frame_of_pandas_gives_residuals_with_its_labels(make_recording: Maker) -> None:
    import pandas as pd

    path = make_recording(noise=2e-4, samples=600)
    table = api.load(path).to_pandas()
    wanted = api.identify(path, "linear", trials=1)
    dates = table.set_index(pd.Timestamp("2026-01-01") + pd.to_timedelta(table.index, unit="s"))
    dates.index.name = None
    zoned = dates.tz_localize("Europe/Berlin")
    empty = table.astype("Float64").reset_index()
    empty.loc[300, "torque"] = pd.NA
    for given in (table, dates, zoned, empty):
        found = api.identify(given, "linear", trials=1)
        assert found["Kc"].value == pytest.approx(wanted["Kc"].value, rel=1e-3)
        assert found.residuals.index.equals(given.index[found.rows])
        assert found.predict(given).equals(found.predicted)
    part = api.identify(table, "linear", trials=1, start=0.2).residuals
    assert part.index[0] >= 0.2
    whole = api.identify(table, "linear", trials=1).residuals
    both = part.index.intersection(whole.index)
    assert len(both) > 450
    np.testing.assert_allclose(part[both], whole[both], atol=2e-5)
    assert pd.DataFrame.from_dict(found.conf_int(), orient="index").shape == (2, 2)


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"torque": [1.0] * 9}, "dtheta missing"),
        ({"dtheta": [1.0] * 8, "torque": [1.0] * 9}, r"different lengths \(time 9, torque 9, dtheta 8\)"),
        ({"dtheta": [[1.0]] * 9, "torque": [1.0] * 9}, r"dtheta has the shape \(9, 1\)"),
        ({"dtheta": [None, "x", *range(7)], "torque": [1.0] * 9}, "dtheta holds values that are no numbers"),
        ({"dtheta": [math.nan] * 9, "torque": [1.0] * 9}, "holds 0 usable sample"),
    ],
)
def test_arrays_that_are_no_recording_are_refused_in_a_sentence(arrays: dict[str, Any], said: str) -> None:
    with pytest.raises((api.WrongUse, api.Untrustworthy), match=said):
        api.identify(time=np.arange(9.0), **arrays)


def test_one_sample_both_or_neither_are_refused(make_recording: Maker) -> None:
    with pytest.raises(api.WrongUse, match="give either recordings, or the arrays"):
        api.identify()
    with pytest.raises(api.WrongUse, match="give either recordings, or the arrays"):
        api.identify(make_recording(samples=100), time=[1.0])
    with pytest.raises(api.WrongUse, match="1 samples determine neither"):
        api.identify(time=[1.0], torque=[1.0], dtheta=[1.0])


@pytest.mark.study
def test_a_part_of_a_recording_gives_what_a_recording_of_that_part_gives(hil: Hil, make_recording: Maker) -> None:
    whole = make_recording(noise=2e-4, change=lambda channels: channels["torque"][:500].__imul__(3.0))
    part = api.load(whole, start=1.0, end=3.998)
    assert (len(part), part.window) == (1500, (1.0, 3.998))
    alone: dict[str, Any] = {name: part[name] for name in ("time", "torque", "dtheta")}
    wanted = api.identify(**alone, model="linear", trials=1).as_json()
    words = ("--from", "1000 ms", "--to", 3.998)
    by_command = hil("identify", whole, *words, "--model", "linear", "--trials", 1, "--json").json
    for found in (
        api.identify(whole, "linear", trials=1, start="1 s", end=3.998).as_json(),
        api.identify(part, "linear", trials=1).as_json(),
        api.identify_each([whole], "linear", trials=1, start=pint.Quantity("1000 ms"), end=3.999)[0].as_json(),
        by_command,
    ):
        assert found["windows"] == [[1.0, 3.998]]
        assert (found["parameters"], found["samples"]) == (wanted["parameters"], wanted["samples"])
    assert wanted["windows"] == [None]
    assert "only a part was used" in hil("identify", whole, *words, "--model", "linear", "--trials", 1).out
    other = make_recording("b.h5", noise=2e-4, seed=1)
    compared = hil("compare", whole, other, *words, "--model", "linear", "--trials", 1, "--json").json
    assert compared["recordings"][0]["parameters"]["Kc"]["value"] == wanted["parameters"]["Kc"]["value"]
    assert hil("export", whole, "-o", "w.csv", *words).out.strip() == "w.csv: 1500 rows"
    assert hil("inspect", whole, *words, "--json").json["samples"] == 1500


@pytest.mark.parametrize(
    ("first", "last", "said"),
    [
        (30, None, "no row is between --from and --to"),
        (None, -1, "no row is between --from and --to"),
        (0.0011, 0.0019, "no row is between --from and --to"),
        (3, "2 s", "--from 3 s is after --to 2 s"),
        ("nan", None, "--from: 'nan' is not a number"),
        ("0,5", None, "has a decimal comma: write 0.5"),
        ("2 mm", None, "'mm' is not a unit of time"),
    ],
)
def test_a_window_without_rows_is_refused_with_the_times_of_the_recording(
    hil: Hil, make_recording: Maker, first: Any, last: Any, said: str
) -> None:
    path = make_recording(samples=500)
    words = [word for option, at in (("--from", first), ("--to", last)) if at is not None for word in (option, at)]
    for command in (("identify",), ("inspect",), ("export", "-o", "a.csv")):
        ended = hil(command[0], path, *command[1:], *words)
        assert ended.status == 2
        assert said in ended.err
        assert "its times are from 0 s to 0.998 s" in ended.err


@pytest.mark.parametrize("bound", [math.nan, math.inf, [1.0], True, b"1", pint.Quantity("2 m")])
def test_a_time_that_is_none_is_refused_with_the_times_of_the_recording(make_recording: Maker, bound: Any) -> None:
    path = make_recording(samples=500)
    for call in (api.load, api.identify):
        with pytest.raises(api.WrongUse, match=r"is no time.*its times are from 0 s to 0.998 s"):
            call(path, end=bound)


def test_a_part_that_is_too_short_is_named_and_no_longer_recording_is_asked_for(make_recording: Maker) -> None:
    with pytest.raises(
        api.NoResult, match=r"a\.h5 from 1 to 1\.004 s holds 3 usable .* of 3: take a part with at least 16"
    ):
        api.identify(make_recording(samples=600), start=1.0, end=1.005)


def test_the_version_is_that_of_the_package() -> None:
    assert api.__version__ == version("hil")


def test_a_comparison_is_the_command_lines(hil: Hil, make_recording: Maker) -> None:
    paths = [make_recording(f"{seed}.h5", noise=2e-4, seed=seed, samples=500) for seed in range(2)]
    result = api.compare(*paths, model="linear", trials=1)
    assert (
        json.loads(json.dumps(result.as_json()))
        == hil("compare", *paths, "--model", "linear", "--trials", 1, "--json").json
    )
    assert len(repr(result)) < 600
    assert str(result).splitlines() == [result["Kc"].verdict, result["Bc"].verdict]
    assert result.plot().axes


@pytest.mark.study
def test_a_design_says_itself_in_a_line_and_the_best_beats_the_one_given(hil: Hil) -> None:
    result = api.design("sim", "multisine", duration=1.0)
    shown = hil("design", "--backend", "sim", "--profile", "multisine", "--duration", 1).out
    assert set(re.findall(r"\b([mu]?)N m", shown)) == {"m"}
    assert "\n" not in str(result)
    assert result.best.relative <= result.given.relative
    assert len(repr(result)) < 300


def test_an_unusable_recording_raises_with_the_json_of_the_command_line(hil: Hil, make_recording: Maker) -> None:
    path = make_recording(samples=8)
    with pytest.raises(api.NoResult) as caught:
        api.identify(path)
    assert isinstance(caught.value, api.Untrustworthy)
    ended = hil("identify", path, "--json")
    assert (ended.status, ended.json) == (1, caught.value.as_json())


def test_a_run_beyond_a_limit_raises_and_says_what_was_recorded(tmp_path: Path) -> None:
    stand = tmp_path / "stand.toml"
    stand.write_text(
        '[stand]\nbackend = "sim"\ngear_ratio = 4.0\ntorque_source = "joint"\n'
        "[limits]\ntorque = 0.03\ndeflection = 0.05\nvelocity = 100.0\n"
    )
    ended: list[api.Run] = []
    with pytest.raises(LimitReached):
        api.record(stand, amplitude=0.02, duration=2.0, output=tmp_path / "a.h5", ended=ended.append)
    assert ended[0].outcome.samples == len(ended[0].load()) > 0
