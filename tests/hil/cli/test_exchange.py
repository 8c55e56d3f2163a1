"""`hil import` and `hil export` as a person runs them: every bad file ends with one sentence and status 2."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from hil.recording.reader import Recording

from ..conftest import Hil, Maker

COLUMNS = ("--time", "t", "--torque", "q", "--dtheta", "a", "--time-unit", "s", "--dtheta-unit", "rad")
NAMED = (*COLUMNS, "--torque-unit", "N*m")
GOOD = "t,q,a,run\n" + "".join(f"{i / 100},{np.sin(i)},{np.cos(i)},{i // 50}\n" for i in range(100))


@pytest.mark.parametrize(
    ("text", "words", "said"),
    [
        (GOOD, ("--where", "run==9"), "no row passes run==9"),
        (GOOD, ("--where", "run~9"), "write a column"),
        (GOOD, ("--torque-unit", "Nmm/s"), "unknown unit of torque"),
        (GOOD, ("--dtheta-dot", "rate"), "no column 'rate'"),
        (GOOD, ("--dtheta-dot-unit", "rpm"), "need a column: name it with --dtheta-dot"),
        (GOOD, ("--motor-torque", "q"), "give either --torque or --motor-torque"),
        (GOOD.replace(",q,", ",q [mN m],"), ("--torque-unit", "N*m"), "in mN m by its heading"),
        (GOOD.replace("0.5", "half "), (), " is not a number"),
        (re.sub(r"(0\.5\d*,)", r"\1 1,", GOOD), (), "5 fields, but the header names 4"),
        (re.sub(r"\n0\.[5-9]", "\n0.1", GOOD), (), "the time goes backwards"),
        (GOOD.replace(",", ";").replace(".", ",", 1), (), "decimals both ways"),
        (GOOD + '1,2,3,"' + "x" * 131073 + '"\n', (), "longer than 131072 characters"),
    ],
)
def test_a_bad_table_ends_with_one_sentence_the_table_and_status_2(
    hil: Hil, tmp_path: Path, text: str, words: tuple[str, ...], said: str
) -> None:
    (tmp_path / "a.csv").write_text(text)
    status, out, err = hil("import", "a.csv", "-o", "a.h5", *NAMED, *words)
    assert (status, out) == (2, "")
    assert said in err.splitlines()[0]
    assert not err.splitlines()[1:] or err.splitlines()[-1].startswith("  hil import a.csv --time t ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv"]


def test_the_import_says_what_it_understood(hil: Hil, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\ufeff" + GOOD.replace(",q,", ",q [mN m],"))
    status, out, err = hil("import", "a.csv", "-o", "a.h5", *COLUMNS, "--where", "run==1", "--torque-scale", -2)
    assert (status, err) == (0, "")
    ranges = "torque -2 to 2 mN m; deflection -1 to 0.999 rad, a span of 115 deg"
    assert out == f"a.h5: 50 samples over 0.49 s; {ranges}\nread time in s, torque in mN m, dtheta in rad\n"
    with Recording(tmp_path / "a.h5") as recording:
        np.testing.assert_allclose(recording.channel("torque"), -2e-3 * np.sin(np.arange(50, 100)))


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("--torque tau --dtheta a --torque-unit mN*m", "--torque tau --dtheta a"),
        ("--torque a --dtheta tau", "--torque NAME --dtheta NAME"),
        ("--motor-torque tau --motor-position a", "--motor-torque tau --motor-position a --stand FILE"),
    ],
)
def test_the_command_that_was_refused_is_not_offered_again(hil: Hil, tmp_path: Path, words: str, offered: str) -> None:
    (tmp_path / "a.csv").write_text(GOOD.replace("t,q,a", "t [s],tau [N*m],a [rad]"))
    status, _, err = hil("import", "a.csv", "-o", "b.h5", "--time", "t", *words.split())
    assert status == 2
    assert err.splitlines()[-1] == f"  hil import a.csv --time t {offered} -o a.h5"


@pytest.mark.parametrize("words", [(), ("--look",), ("--torque", "cell [mN*m]", "-o", "a.h5", "--look")])
def test_a_look_shows_what_is_understood_and_the_command_that_imports_it(
    hil: Hil, tmp_path: Path, words: tuple[str, ...]
) -> None:
    rows = "".join(f"{i / 100},0.5,{i % 7},{np.sin(i)},{np.cos(i)},run\n" for i in reversed(range(100)))
    (tmp_path / "a.csv").write_text("_time [s],_start [s],torque_cmd [mN*m],cell [mN*m],joint angle,mode\n" + rows)
    status, out, err = hil("import", "a.csv", *words)
    assert (status, err) == (0, "")
    assert re.search(r"\n +cell \[mN\*m\] +mN\*m +torque +-0.99\d* +0.99\d*", out)
    assert re.search(r"\n +joint angle +not stated +dtheta +-0.99\d* +1\n", out)
    assert re.search(r"\n +mode +no numbers\n", out)
    assert re.search(r"\n +_start \[s\] +s +0.5 .*\n +torque_cmd \[mN\*m\] +mN\*m +set-point +0 ", out)
    assert "does not say the unit of 'joint angle'" in out
    command = out.splitlines()[-1].split("hil ")[1].replace("UNIT", "rad")
    assert re.match("import a.csv --time _time --torque '?cell", command)
    status, out, err = hil(*shlex.split(command))
    assert status == 0, err
    assert "newest row is the first" in out + err


def test_a_recording_goes_out_as_csv_and_comes_back(hil: Hil, tmp_path: Path, make_recording: Maker) -> None:
    make_recording("a.h5", samples=200)
    assert hil("export", "a.h5", "-o", "a.csv") == (0, "a.csv: 200 rows\n", "")
    status, _, err = hil("export", "a.h5", "-o", "a.csv")
    assert status == 2
    assert "--force" in err
    assert hil("export", "a.h5", "-o", "a.csv", "--force")[0] == 0
    assert hil("import", "a.csv", "-o", "b.h5")[0] == 0
    with Recording(tmp_path / "a.h5") as first, Recording(tmp_path / "b.h5") as second:
        np.testing.assert_array_equal(first.channel("torque"), second.channel("torque"))


REAL = (
    "--time",
    "TIME",
    "--torque",
    "TORQUE",
    "--dtheta",
    "POSITION",
    "--dtheta-unit",
    "rev",
    "--time-unit",
    "s",
    "--torque-unit",
    "N*m",
)


@pytest.mark.parametrize(("name", "rows"), [("base_onyx_runin1", 9040), ("split_onyx_12pre1", 8251)])
def test_a_real_run_is_brought_in_whole(hil: Hil, tmp_path: Path, locked_output: Path, name: str, rows: int) -> None:
    """The row count is awk's; a plain line through torque and deflection is near SOURCE.md's stiffness."""
    source = locked_output / f"{name}.csv.gz"
    status, out, err = hil("import", source, "-o", "a.h5", *REAL, "--where", "test_nr==100")
    assert (status, err) == (0, "")
    assert out.startswith(f"a.h5: {rows} samples over 2")
    with Recording(tmp_path / "a.h5") as recording:
        time, dtheta, torque = (recording.channel(channel) for channel in ("time", "dtheta", "torque"))
    assert time[0] == 0.0
    assert (np.diff(time) == 0.0).mean() > 0.7  # the clock ticks every 15.6 ms, and the import alters nothing
    steps = np.unique(np.diff(np.unique(dtheta)) * 2**16 / (2.0 * np.pi))
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)  # whole counts of 2^-16 rev
    slope = np.polyfit(dtheta, torque, 1)[0]
    assert (240.0 if name.startswith("base") else 190.0) < slope < (300.0 if name.startswith("base") else 225.0)


def test_a_real_file_of_several_runs_is_taken_whole_where_its_clock_goes_on(hil: Hil, locked_output: Path) -> None:
    source = locked_output / "split_onyx_12pre1.csv.gz"
    status, out, _ = hil("import", source, "-o", "a.h5", *REAL, "--where", "test_nr<=4", "--where", "test_nr>=0")
    assert status == 0
    assert out.startswith("a.h5: 8557 samples")
