"""Bad input to the commands: outputs that are inputs, odd names, damaged files, closed pipes."""

from __future__ import annotations

import gzip
import json
import os
import random
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

import hil as hil_package
from hil.recording.channels import Row
from hil.recording.reader import Recording
from hil.recording.writer import Header, RecordingWriter

from ..conftest import Hil, Maker, edited

SIM = ("record", "--backend", "sim", "--duration", "1", "--fade", "0.2")


@pytest.fixture(autouse=True)
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def unfinished(name: str, rows: int = 800) -> Path:
    with RecordingWriter(Path(name), Header(profile={"kind": "chirp"}), 1000) as part:
        for seq in range(rows):
            part.append(Row(seq, time=seq / 500.0))
    return part.path


# --- nothing that is there is destroyed ------------------------------------------------------------------------------


def test_recovering_with_force_keeps_what_it_recovers(hil: Hil) -> None:
    part = unfinished("a.h5")
    before = part.read_bytes()
    Path("a.h5").write_text("an old one")
    assert hil("recover", part)[0] == 2
    assert hil("recover", part, "--force")[0] == 0
    assert part.read_bytes() == before
    with Recording(Path("a.h5")) as recording:
        assert len(recording) == 800


def test_recovering_a_part_without_a_row_gives_an_empty_recording(hil: Hil) -> None:
    status, out, _ = hil("recover", unfinished("a.h5", rows=0))
    assert (status, out) == (0, "a.h5: 0 samples recovered; a.h5.part is still there\n")
    status, _, err = hil("inspect", "a.h5")
    assert status == 1
    assert "fault in hil" not in err


def test_importing_gives_no_unfinished_recording_up(hil: Hil) -> None:
    part = unfinished("a.h5")
    Path("s.csv").write_text("t,q,p\n0,1,2\n1,2,3\n")
    columns = ("--time", "t", "--torque", "q", "--dtheta", "p")
    for force in ((), ("--force",)):
        status, _, err = hil("import", "s.csv", *columns, "-o", "a.h5", *force)
        assert status == 2
        assert "never ended" in err
    assert part.exists()


def test_no_command_overwrites_what_it_reads(hil: Hil, make_recording: Maker) -> None:
    recording = make_recording("c.html")
    Path("s.csv").write_text("0,0\n1,0.004\n2,0\n")
    Path("stand.toml").write_text('[stand]\nbackend = "sim"\n[limits]\ntorque = 0.03\ndeflection = 1\nvelocity = 100\n')
    before = {path: path.read_bytes() for path in (recording, Path("s.csv"), Path("stand.toml"))}
    columns = ("--time", "t", "--torque", "q", "--dtheta", "p")
    for words in [
        ("import", "s.csv", *columns, "-o", "s.csv"),
        ("import", "s.csv", *columns, "--stand", "stand.toml", "-o", "stand.toml"),
        ("identify", "c.html", "--report", "c.html"),
        ("identify", "c.html", "--report", recording),
        ("recover", "c.html", "-o", "c.html"),
        ("record", "--stand", "stand.toml", "-o", "stand.toml"),
        (*SIM, "--profile", "file", "--setpoints", "s.csv", "-o", "./s.csv"),
    ]:
        status, _, err = hil(*words, "--force")
        assert (status, "is also an input" in err) == (2, True), words
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.study
def test_the_file_of_a_report_is_looked_at_before_any_work(
    hil: Hil, make_recording: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.api.analysis.identified", lambda *_: pytest.fail("it has begun to work"))
    Path("p.html").write_text("mine")
    status, _, err = hil("identify", make_recording(), "--report", "p.html")
    assert status == 2
    assert "p.html exists" in err
    assert hil("identify", make_recording(), "--report", "q.png")[0] == 2


@pytest.mark.study
def test_a_report_does_not_replace_a_file_that_appears_while_it_is_made(
    hil: Hil, make_recording: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = "p.html"
    monkeypatch.setattr("hil.report.html_page.library", lambda: Path(taken).write_text("somebody's") and {})
    words = ("--model", "linear", "--trials", 1, "--report", "p.html")
    status, _, err = hil("identify", make_recording(noise=1e-5, samples=600), *words)
    assert status == 2
    assert f"{taken} exists" in err
    assert Path(taken).read_text() == "somebody's"


def test_a_demo_does_not_overwrite_the_report_of_an_earlier_one(hil: Hil) -> None:
    Path("hil-demo").mkdir()
    Path("hil-demo/run1.html").write_text("mine")
    status, _, err = hil("demo")
    assert status == 2
    assert "run1.html exists" in err
    assert [item.name for item in Path("hil-demo").iterdir()] == ["run1.html"]


# --- what is wrong use is said to be that ----------------------------------------------------------------------------


IMPOSSIBLE: list[tuple[object, ...]] = [
    (*SIM, "--seed", "-1"),
    (*SIM, "--seed", 2**63),
    (*SIM, "-o", "n" * 300 + ".h5"),
    (*SIM, "-o", "n" * 251 + ".h5"),
    (*SIM, "-o", "n" * 251 + ".h5", "--force"),
    ("record", "--stand", "n" * 300),
    ("inspect", "n" * 300),
    ("identify", "n" * 300),
    ("identify", "a.h5", "--seed", 2**63),
    ("identify", "a.h5", "--report", "n" * 300 + ".html"),
    ("recover", "n" * 300 + ".part"),
    ("demo", "-o", "n" * 300),
    ("import", "n" * 300, "-o", "b.h5", "--time", "t", "--torque", "q", "--dtheta", "p"),
    ("import", "wide.csv", "-o", "b.h5", "--time", "t", "--torque", "q", "--dtheta", "p"),
    (*SIM, "--profile", "file", "--setpoints", "wide.csv"),
    (*SIM, "--profile", "file", "--setpoints", "set.csv", "--band", "0.1:15"),
]


def test_what_cannot_be_done_is_wrong_use_and_no_fault_of_hils(hil: Hil, make_recording: Maker) -> None:
    make_recording(samples=50)
    Path("set.csv").write_text("0,0\n1,0.004\n2,0\n")
    Path("wide.csv").write_text("t,q,p\n0,1," + "2" * 140_000 + "\n")
    before = sorted(Path().iterdir())
    for words in IMPOSSIBLE:
        status, out, err = hil(*words)
        assert (status, out) == (2, ""), words
        assert "fault in hil" not in err, words
        assert "Traceback" not in err, words
        assert sorted(Path().iterdir()) == before, words


@pytest.mark.study
def test_the_largest_seed_is_kept(hil: Hil) -> None:
    assert hil(*SIM, "--seed", 2**63 - 1, "-o", "a.h5")[0] == 0
    with h5py.File("a.h5") as file:
        assert file.attrs["seed"] == 2**63 - 1


@pytest.mark.study
@pytest.mark.usefixtures("damaged_files")
def test_damaged_files_are_said_to_be_damaged(hil: Hil, make_recording: Maker) -> None:
    """Bytes anywhere, most of them metadata; the samples have their checksums. Never a fault of hil's."""
    data = make_recording("a.h5", samples=64).read_bytes()
    generator = random.Random(1)  # noqa: S311 - no secret
    seen = set()
    for count in (0, 4, 64):
        damaged = bytearray(data)
        for _ in range(count):
            damaged[generator.randrange(len(data))] = generator.randrange(256)
        Path("m.h5").write_bytes(damaged)
        for words in (("inspect", "m.h5"), ("recover", "m.h5", "-o", "r.h5", "--force")):
            status, _, err = hil(*words)
            assert "fault in hil" not in err
            seen.add(status)
    assert {0, 2} <= seen <= {0, 1, 2}


@pytest.mark.study
def test_a_stiff_simulated_stand_is_said_to_be_slow(hil: Hil) -> None:
    text = (
        '[stand]\nbackend = "sim"\ngear_ratio = 4.0\n[limits]\ntorque = 0.03\ndeflection = 1\nvelocity = 100\n'
        "[sim.fixture]\nstiffness = {}\n"
    )
    for stiffness, slow in ((20.0, False), (1e7, True)):
        Path("stand.toml").write_text(text.format(stiffness))
        words = ("record", "--stand", "stand.toml", "--duration", "0.2", "--band", "10:15", "-o", f"{stiffness}.h5")
        status, _, err = hil(*words)
        assert (status, "[slow-simulation]" in err) == (0, slow)


# --- what is shown ---------------------------------------------------------------------------------------------------


@pytest.mark.study
def test_a_name_is_shown_as_it_is(hil: Hil) -> None:
    assert hil(*SIM, "-o", "[red]a.h5")[0] == 0
    assert "[red]a.h5: chirp, done" in hil("inspect", "[red]a.h5")[1]


STEERING = "\x1b[2J\x1b]0;owned\x07\x9b31m\u202e"


def test_no_text_of_a_file_steers_the_terminal(hil: Hil, make_recording: Maker) -> None:
    """End reasons, kinds of profiles, keys, headings and file names, all of which somebody else may have written."""
    with edited(make_recording("a.h5", noise=1e-5, samples=600)) as file:
        file.attrs["end_reason"] = STEERING
        file["profile"].attrs["kind"] = STEERING
    name = f"b{STEERING}.h5"
    Path("a.h5").rename(name)
    Path("stand.toml").write_text('[stand]\n"k\\u001b[2Jy" = 1\n"\\u009b" = "\\u001b[31m"\n')
    Path("s.csv").write_text(f"t{STEERING},q{STEERING},p\n0,1,2\n")
    shown = ""
    for words in [
        ("inspect", name),
        ("inspect", name, "--verify"),
        ("identify", name, "--model", "linear"),
        ("inspect", f"none{STEERING}"),
        ("inspect", "a.h5", f"--{STEERING}"),
        ("record", "--stand", "stand.toml"),
        ("import", "s.csv", "--time", "x", "--torque", "q", "--dtheta", "p", "-o", "c.h5"),
    ]:
        ended = hil(*words)
        shown += ended.out + ended.err
    assert shown.count("\\x1b[2J") >= 7
    assert not set(STEERING) - set("[2J]0;owned31m") & set(shown)


def test_a_file_name_that_is_no_text_is_shown(hil: Hil) -> None:
    status, _, err = hil("inspect", "a\udcff.h5")
    assert (status, "a\\udcff.h5 cannot be opened" in err) == (2, True)


@pytest.mark.study
def test_a_reader_that_has_seen_enough_is_no_error(make_recording: Maker) -> None:
    make_recording("a.h5", noise=1e-4)
    code = "import sys; from hil.cli.app import main; sys.argv = ['hil', *sys.argv[1:]]; main()"
    command = [sys.executable, "-W", "ignore", "-c", code, "inspect", "a.h5"]
    here = {"PYTHONPATH": str(Path(hil_package.__file__).parent.parent)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=os.environ | here) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()  # as `head` does once it has its line
        err = process.stderr.read()
        assert (process.wait(), err) == (0, b"")


# --- declared sizes, and what is no file -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["fifo", "/dev/zero", "."])
def test_only_ordinary_files_are_read(hil: Hil, name: str) -> None:
    os.mkfifo("fifo")
    for path in (name,) if name != "fifo" else ("fifo", "fifo.mat", "fifo.csv.gz"):
        if path.startswith("fifo."):
            os.mkfifo(path)
        columns = ("--time", "t", "--torque", "q", "--dtheta", "p", "-o", "b.h5")
        for words in [
            ("record", "--stand", path),
            (*SIM, "--profile", "file", "--setpoints", path),
            ("import", path, *columns),
            ("inspect", path),
        ]:
            status, _, err = hil(*words)
            assert (status, "is not a file" in err) == (2, True), words


def test_a_line_without_end_is_not_read_whole(hil: Hil, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.exchange.text.rows._LONGEST", 1 << 12)
    with gzip.open("a.csv.gz", "wb", compresslevel=1) as file:
        file.write(b"1,2," * (1 << 12))
    Path("b.csv").write_text("t,q,p\n" + "1," * (1 << 12))
    for name in ("a.csv.gz", "b.csv"):
        status, _, err = hil("import", name, "--time", "t", "--torque", "q", "--dtheta", "p", "-o", "b.h5")
        assert (status, "fault in hil" in err) == (2, False)


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 5000, "a." * 5000 + "b = 1", "a = " + "9" * 5000, "#" * (1 << 20) + "#"]
)
def test_a_nested_or_huge_stand_file_is_wrong_use(hil: Hil, text: str) -> None:
    Path("stand.toml").write_text(text)
    status, _, err = hil("record", "--stand", "stand.toml")
    assert (status, "fault in hil" in err, len(err) < 500) == (2, False, True)


def test_of_very_many_errors_the_first_are_looked_at(hil: Hil, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[object] = []

    def line_of(_text: str, place: object) -> int:
        looked.append(place)
        return len(looked)

    monkeypatch.setattr("hil.stand.file.line_of", line_of)
    Path("stand.toml").write_text("[stand]\n" + "".join(f"k{at} = 1\n" for at in range(500)))
    status, _, err = hil("record", "--stand", "stand.toml")
    assert (status, "has 500 error(s)" in err, "and 480 more" in err, len(looked)) == (2, True, True, 20)


def test_a_word_of_a_megabyte_does_not_fill_the_terminal(hil: Hil) -> None:
    Path("a.json").write_text(json.dumps({"schema": "q" * 1_000_000}))
    status, _, err = hil("export", "a.json", "-o", "a.xml")
    assert (status, "more characters" in err, len(err) < 11_000) == (2, True, True)


@pytest.mark.parametrize("ratio", ["1e300", "1e-300", "1e-9", "0", "-1", "nan", "inf"])
def test_a_gear_that_nobody_builds_is_wrong_use(hil: Hil, ratio: str) -> None:
    Path("stand.toml").write_text(f'[stand]\nbackend = "sim"\ngear_ratio = {ratio}\n[limits]\ntorque = 1\n')
    status, _, err = hil("record", "--stand", "stand.toml")
    assert (status, "stand.gear_ratio" in err) == (2, True)


@pytest.mark.study
def test_a_run_whose_standard_files_are_closed_records_as_any_other(tmp_path: Path) -> None:
    """The files that a run opens must not take their numbers: other processes are given those anew."""
    words = "record --backend sim --realtime --profile sine --duration 0.2 --rate 100 -o a.h5"
    command = f'exec "{sys.executable}" -m hil {words} <&- >&- 2>&-'
    ended = subprocess.run(["sh", "-c", command], cwd=tmp_path, check=False, capture_output=True)
    assert ended.returncode == 0, ended.stderr
    with Recording(tmp_path / "a.h5") as recording:
        assert len(recording) == 21


def test_the_processes_of_a_run_inherit_the_standard_files_that_were_closed() -> None:
    """What libhdf5 or a guardian writes to standard error would otherwise go into the file that has this number."""
    child = "import os; os.fstat(0), os.fstat(2)"
    program = f"import subprocess, sys, hil; print(subprocess.call([sys.executable, '-c', {child!r}]))"
    ended = subprocess.run(
        ["sh", "-c", 'exec "$0" -c "$1" <&- 2>&-', sys.executable, program], check=False, capture_output=True
    )
    assert ended.stdout.split() == [b"0"]
