"""A whole run, from the command to the file: whatever fails, and whoever else records, no torque and no lost data."""

from __future__ import annotations

import errno
import io
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.servo import Command, LinkLost, NoReply, Quantity, Sample, ServoInfo
from hil.acquisition import excitation, recorder
from hil.acquisition import run as run_module
from hil.acquisition.commissioning import Commissioning
from hil.acquisition.excitation import Profile
from hil.acquisition.interrupt import ending
from hil.acquisition.run import run
from hil.acquisition.setpoints import SetPoints
from hil.cli import app as cli
from hil.errors import WrongUse
from hil.recording import writer as writer_module
from hil.recording.channels import TorqueScale
from hil.recording.reader import Recording
from hil.recording.writer import Header, RecordingWriter
from hil.stand.file import SIMULATED, parse
from sim_backend.fault_plan import FaultPlan, PlannedFault
from sim_backend.parameters import SimParameters
from sim_backend.servo import SimServo

from ...late_ticks import ALLOW
from ..conftest import SpringServo, copied, exit_status

RATE = 100.0
STAND = parse(
    '[stand]\nbackend = "sim"\ngear_ratio = 4.0\ntorque_source = "joint"\n'
    "[limits]\ntorque = 0.1\ndeflection = 0.06\nvelocity = 50.0\n"
)


def profile(duration: float) -> Profile:
    return excitation.make(
        "sine",
        Quantity.TORQUE,
        amplitude=0.05,
        default_amplitude=1.0,
        duration=duration,
        band=(2.0, 2.0),
        rate=RATE,
        fade=0.1,
    )


@pytest.fixture
def spring(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> SpringServo:
    """The servo that every stand opens, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    servo = SpringServo()
    monkeypatch.setattr(run_module, "open_servo", lambda *_, **__: (servo, {}))
    return servo


def record(*words: str) -> int:
    return cli.run(["record", "--backend", "sim", "--rate", "100", "--band", "2", "--profile", "sine", *words])


def test_a_recording_says_how_well_the_scale_of_its_torque_is_known(spring: SpringServo) -> None:
    table = "mx-64's torque constant of the maker's table"
    cell: tuple[str, Any] = ("cell", {})
    for known, sensor, words in ((0.25, None, table), (math.nan, None, "mx-64"), (0.25, cell, "the torque cell")):
        spring.info = replace(spring.info, model="mx-64", torque_uncertainty=known)
        run(replace(STAND, sensor=sensor), profile(0.2), rate=RATE, seed=0, output=Path("a.h5"), force=True)
        with Recording(Path("a.h5")) as recording:
            assert TorqueScale.stored(recording.attributes).source == words
            assert TorqueScale.stored(recording.attributes).included == (0.25 if words == table else 0.0)


# --- the question before a real motor moves --------------------------------------------------------------------------


class Terminal(io.StringIO):
    """A terminal in which a person types the given text; without one, Ctrl-C."""

    def isatty(self) -> bool:
        return True

    def readline(self, size: int = -1, /) -> str:  # type: ignore[override]  # a text stream's
        if self.getvalue() == "Ctrl-C":
            raise KeyboardInterrupt
        return super().readline(size)


REAL = """
[stand]
name = "finger"
backend = "moteus"
[limits]
torque = 0.4
deflection = 1.0
velocity = 60.0
[moteus]
interface = "virtual"
channel = "stand"
"""
MOVE = ["--profile", "sine", "--band", "2", "--amplitude", "0.1", "--duration", "1", "--rate", "100", "-o", "a.h5"]


@pytest.fixture
def real(spring: SpringServo, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., int]:
    """Return a function that records on a stand with a real motor, and returns the exit status."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    Path("stand.toml").write_text(REAL)

    def run_it(typed: str, *words: str, stand: str = REAL, terminal: type[io.StringIO] = Terminal) -> int:
        Path("stand.toml").write_text(stand)
        Path("a.h5").unlink(missing_ok=True)
        spring.driven.clear()
        monkeypatch.setattr("sys.stdin", terminal(typed))
        status = cli.run(["record", *MOVE, *words])
        assert bool(spring.driven) == Path("a.h5").exists() == (status == 0)
        return status

    return run_it


def test_a_real_motor_moves_for_the_first_time_only_after_a_yes_and_then_without_a_question(
    real: Callable[..., int], capfd: pytest.CaptureFixture[str]
) -> None:
    for answer, status in (("n\n", 2), ("\n", 2), ("", 2), ("Ctrl-C", 130)):
        assert real(answer) == status
        said = capfd.readouterr()
        assert "'finger' (moteus, interface virtual, channel stand, id 1) will move with up to 0.1 N m at " in said.err
        assert "for 1 s." in said.err
    assert real("y\n") == 0
    assert real("n\n") == 0
    assert real("n\n", stand=REAL.replace("0.4", "0.5")) == 2  # not the file to which the person agreed


@pytest.mark.parametrize(
    ("words", "terminal"),
    [(["--yes"], Terminal), ([], io.StringIO), (["--backend", "sim"], Terminal)],
    ids=["--yes", "no terminal", "simulated"],
)
def test_a_script_a_service_and_the_simulated_servo_are_not_asked(
    real: Callable[..., int], words: list[str], terminal: type[io.StringIO]
) -> None:
    assert real("n\n", *words, *(["--amplitude", "0.01"] if "sim" in words else []), terminal=terminal) == 0
    assert real("n\n") == 2  # and nothing of it counts as a yes


@pytest.mark.parametrize(("days", "status"), [(1.0, 0), (31.0, 2)])
def test_a_commissioned_drive_moves_without_a_question(real: Callable[..., int], days: float, status: int) -> None:
    tested = Commissioning(time.time() - days * 86400.0, "1", 0.1, releases=True, guardian=True, second_signal=True)
    tested.keep(parse(REAL), ServoInfo(backend="moteus", model="n1", serial="11"), Quantity.TORQUE)
    assert real("n\n", stand=REAL.replace('"finger"', '"other"')) == status
    assert real("n\n", stand=REAL.replace("virtual", "socketcan")) == 2  # not the drive that was tested


# --- a fault at every call -------------------------------------------------------------------------------------------


class Saboteur:
    """Raises at the `at`-th call of all that it stands in front of, before the call acts or after it has."""

    def __init__(self, error: BaseException, at: int, *, after: bool) -> None:
        self.error, self.at, self.after = error, at, after
        self.calls = 0

    def before(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*words: Any, **settings: Any) -> Any:
            self.calls += 1
            due = self.calls == self.at
            if due and not self.after:
                raise self.error
            answer = function(*words, **settings)
            if due:
                raise self.error
            return answer

        return call

    def spoil(self, monkeypatch: pytest.MonkeyPatch, servo: SpringServo) -> None:
        for name in ("arm", "exchange", "disarm", "close"):
            monkeypatch.setattr(servo, name, self.before(getattr(servo, name)))
        for name in ("now", "sleep_until"):
            monkeypatch.setattr(servo.clock, name, self.before(getattr(servo.clock, name)))
        for name in ("append", "flush", "event", "finish", "discard", "close", "__len__"):
            monkeypatch.setattr(RecordingWriter, name, self.before(getattr(RecordingWriter, name)))
        for name in ("write_at", "finalise", "is_at", "remove"):
            monkeypatch.setattr(writer_module, name, self.before(getattr(writer_module, name)))
        for name in ("extend", "__exit__", "__iter__"):
            monkeypatch.setattr(SetPoints, name, self.before(getattr(SetPoints, name)))
        monkeypatch.setattr(Profile, "at", self.before(Profile.at))


@pytest.mark.parametrize(
    ("error", "after", "step"),
    [
        pytest.param(KeyboardInterrupt(), False, 4, id="Ctrl-C"),
        pytest.param(KeyboardInterrupt(), False, 1, id="Ctrl-C everywhere", marks=pytest.mark.study),
        pytest.param(OSError(errno.ENOSPC, "the disk is full"), True, 1, id="disk full", marks=pytest.mark.study),
    ],
)
def test_whatever_fails_at_whichever_call_the_torque_is_off_and_the_rows_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, after: bool, step: int
) -> None:
    monkeypatch.setattr(recorder, "_REST_SAMPLES", 2)
    monkeypatch.setattr(writer_module, "_software", dict)  # these two are most of the time a run takes
    monkeypatch.setattr(os, "fsync", lambda _: None)
    for at in count(1, step):
        servo, saboteur = SpringServo(), Saboteur(error, at, after=after)
        output = tmp_path / f"{at}.h5"
        kept: Path | None = None
        with monkeypatch.context() as patch:
            patch.setattr(run_module, "open_servo", lambda *_, servo=servo, **__: (servo, {}))
            patch.setattr(servo, "close", lambda: None)  # a second net, which must not be needed
            saboteur.spoil(patch, servo)
            try:
                kept, _ = run(STAND, profile(0.03), rate=RATE, seed=0, output=output)
            except (type(error), WrongUse) as raised:
                assert error in {raised, raised.__cause__}  # noqa: PT017 - it may also be in the outcome
        assert not servo.armed, at
        if saboteur.calls < at:
            break
        if len(servo.driven) > 1:
            files = [path for path in (output, output.with_name(output.name + ".part")) if path.exists()]
            assert files, at
            assert kept in {None, *files}
            with Recording(files[0]) as recording:
                assert len(recording) >= len(servo.driven) - 2
    assert at > 60
    assert len(servo.driven) == 4


def test_a_torque_off_that_is_not_confirmed_is_reported_first(
    spring: SpringServo, capfd: pytest.CaptureFixture[str]
) -> None:
    spring.script = {50: LinkLost("the cable is out")}
    spring.disarm_error = OSError(5, "Input/output error")
    assert record("-o", "a.h5") == 3
    message = capfd.readouterr().err.splitlines()
    alarm = "CUT THE POWER: the torque-off is not confirmed ([Errno 5] Input/output error)"
    assert message == [alarm, "hil: the cable is out", alarm]
    with Recording(Path("a.h5")) as recording:
        assert len(recording) == 50


def test_an_alarm_is_raised_before_the_file_is_made_final(spring: SpringServo, tmp_path: Path) -> None:
    spring.disarm_error = OSError(5, "Input/output error")
    seen: list[bool] = []
    run(
        STAND,
        profile(0.5),
        rate=RATE,
        seed=0,
        output=tmp_path / "a.h5",
        alarm=lambda message: seen.append(message.startswith("CUT THE POWER") and not (tmp_path / "a.h5").exists()),
    )
    assert seen == [True]
    assert (tmp_path / "a.h5").exists()


def test_an_alarm_that_cannot_be_printed_costs_neither_the_file_nor_the_exit_status(
    spring: SpringServo, monkeypatch: pytest.MonkeyPatch
) -> None:
    spring.disarm_error = OSError(5, "Input/output error")
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr("sys.stderr", full)
        assert record("-o", "a.h5", "--duration", "3") == 3
    with Recording(Path("a.h5")) as recording:
        assert len(recording) == 301
        assert recording.attributes["end_reason"].startswith("done; CUT THE POWER")


def test_an_outcome_that_cannot_be_printed_does_not_hide_how_the_run_ended(
    spring: SpringServo, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr("sys.stdout", full)
        assert record("-o", "a.h5") == 2
        assert "standard output cannot be written (No space left on device)" in capfd.readouterr().err
    spring.script = {len(spring.driven) + 50: LinkLost("the cable is out")}
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr("sys.stdout", full)
        assert record("-o", "b.h5") == 3
    for name, rows in (("a.h5", 2001), ("b.h5", 50)):
        with Recording(Path(name)) as recording:
            assert len(recording) == rows


def test_an_alarm_that_raises_costs_no_row(spring: SpringServo, tmp_path: Path) -> None:
    spring.disarm_error = OSError(5, "Input/output error")

    def alarm(_: str) -> None:
        raise RuntimeError("nobody listens")

    outcome = run(STAND, profile(0.5), rate=RATE, seed=0, output=tmp_path / "a.h5", alarm=alarm)[1]
    with Recording(tmp_path / "a.h5") as recording:
        assert len(recording) == outcome.samples == 51


@pytest.mark.study
@pytest.mark.parametrize("rate", [49.0, 1000.0])
def test_a_kill_at_any_instant_costs_at_most_twenty_milliseconds_of_rows(
    spring: SpringServo, tmp_path: Path, rate: float
) -> None:
    """At every tenth set-point the rows that a killed process would leave are counted."""
    exchange, lost = spring.exchange, list[int]()

    def counted(command: Command) -> Sample:
        if spring.armed and len(spring.driven) % 10 == 9:
            with Recording(tmp_path / "a.h5.part") as recording:
                lost.append(len(spring.driven) - len(recording))
        return exchange(command)

    spring.exchange = counted  # type: ignore[method-assign]  # watched
    run(STAND, profile(0.5), rate=rate, seed=0, output=tmp_path / "a.h5")
    assert max(lost) / rate <= 0.02


def test_a_link_that_fails_in_a_way_its_driver_did_not_foresee_is_the_stands_failure(
    spring: SpringServo, capfd: pytest.CaptureFixture[str]
) -> None:
    """Not a fault of hil's own, and an EPIPE of a port is no closed standard output."""
    spring.script = {50: BrokenPipeError(errno.EPIPE, "Broken pipe")}
    assert record("-o", "a.h5") == 3
    assert "the link failed" in capfd.readouterr().err


def test_the_servo_is_closed_however_a_run_ends(spring: SpringServo, monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[bool] = []
    monkeypatch.setattr(spring, "close", lambda: closed.append(spring.armed))
    assert record("-o", "a.h5") == 0
    spring.script = {len(spring.driven) + 50: LinkLost("gone")}
    assert record("-o", "b.h5") == 3
    assert record("-o", "none/c.h5") == 2
    monkeypatch.setattr(run_module, "RecordingWriter", lambda *_: 1 / 0)
    assert record("-o", "d.h5") == 70
    assert closed == [False, False, False]


@pytest.mark.parametrize("name", ["INT", "HUP", "RTMAX", "TTOU"])
def test_a_signal_ramps_the_torque_down_and_ends_a_run_with_its_own_status_and_the_data_kept(
    spring: SpringServo, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    number = getattr(signal, f"SIG{name}")
    spring.clock.plans = [(101.0, lambda: os.kill(os.getpid(), number))]
    assert record("-o", "a.h5") == 128 + number
    assert "stopped on request" in capfd.readouterr().out
    assert not spring.armed
    with Recording(Path("a.h5")) as recording:
        assert 80 < len(recording) < 110
        assert abs(recording.channel("command")[-1]) < 0.002  # a tenth of what the profile asks, or less


def test_every_signal_that_ends_a_process_is_taken_and_none_that_does_not() -> None:
    """Each is sent to a process that handles nothing, which echoes what it is sent next, or does not any more."""
    taken = ending()
    for number in sorted(signal.valid_signals()):
        if number in {signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGKILL, signal.SIGSTOP}:
            assert number not in taken
            continue
        if number in {signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU}:  # no effect on a group without a terminal
            assert number in taken
            continue
        with subprocess.Popen("cat", stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(b"1")
            assert process.stdout.read(1) == b"1"
            process.send_signal(number)
            with suppress(BrokenPipeError):
                process.stdin.write(b"2")
            goes_on = process.stdout.read(1) == b"2"
            process.kill()
        assert goes_on == (number not in taken), number


@pytest.mark.study
def test_no_stream_of_signals_replaces_the_exit_status(tmp_path: Path) -> None:
    program = f"{ALLOW}from hil.cli.app import main; main()"
    words = [program, "record", "--backend", "sim", "--realtime", "--duration", "60", "--rate", "100"]
    words += ["-o", str(tmp_path / "a.h5")]
    with subprocess.Popen([sys.executable, "-c", *words], stdout=subprocess.PIPE) as process:
        while process.poll() is None and rows_in(tmp_path / "a.h5.part") < 20:
            time.sleep(0.05)
        while process.poll() is None:
            for number in (signal.SIGTERM, signal.SIGINT, signal.SIGINT):
                process.send_signal(number)
                time.sleep(1e-3)
        # of two that arrive together, the interpreter handles SIGINT first
        assert process.returncode in {128 + signal.SIGTERM, 128 + signal.SIGINT}
    with Recording(tmp_path / "a.h5") as recording:
        assert recording.attributes["end_reason"] == "stopped on request"


@pytest.mark.usefixtures("busy_machine")
@pytest.mark.parametrize("victim", ["recorder", pytest.param("writing process", marks=pytest.mark.study)])
def test_a_kill_in_real_time_costs_no_row_and_leaves_no_process(tmp_path: Path, victim: str) -> None:
    """The rows before the kill are counted in the file that is being written: 20 ms or less may be missing."""
    words = ["record", "--backend", "sim", "--realtime", "--duration", "60", "-o", str(tmp_path / "a.h5")]
    part = tmp_path / "a.h5.part"
    recorder = copied(lambda: cli.run(words))
    while rows_in(part) < 100:
        assert os.waitpid(recorder, os.WNOHANG) == (0, 0)  # it goes on
        time.sleep(0.02)
    writing = int(Path(f"/proc/{recorder}/task/{recorder}/children").read_text())
    before = rows_in(part)
    os.kill(recorder if victim == "recorder" else writing, signal.SIGKILL)
    assert exit_status(recorder) == (-signal.SIGKILL if victim == "recorder" else 1)
    while Path(f"/proc/{writing}").exists():
        time.sleep(0.01)
    with Recording(part if victim == "recorder" else tmp_path / "a.h5") as recording:
        assert len(recording) >= before
        assert recording.verify()
        assert "interrupted" in [event.code for event in recording.events()] or victim != "recorder"


def rows_in(part: Path) -> int:
    """The rows of a recording in progress, 0 where it has not begun."""
    if not part.exists():
        return 0
    with Recording(part) as recording:
        return len(recording)


def test_a_signal_before_the_start_records_nothing(
    spring: SpringServo, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    spring.clock.plans = [(100.05, lambda: os.kill(os.getpid(), signal.SIGTERM))]
    assert record("-o", "a.h5") == 143
    assert capfd.readouterr().out == "nothing was recorded (stopped on request)\n"
    assert spring.limits is None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "fault",
    [
        ("unplug", 3, "CUT THE POWER: the torque-off is not confirmed (the link is gone"),
        ("duplicate", 3, "own clock did not advance in 25 replies"),
        ("stuck-encoder", 3, "angle did not change"),
        ("error", 3, "latched fault 16"),
        ("flip", 3, "no reply for 10 ticks in a row"),
        ("over-temperature", 4, "winding reached 150"),
        ("disk-full", 1, "disk is full, as planned"),
        ("kill", None, ""),
    ],
)
def test_a_planned_fault_ends_the_run_and_the_torque(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    fault: tuple[str, int | None, str],
) -> None:
    kind, status, words = fault
    monkeypatch.chdir(tmp_path)
    servo = simulated(monkeypatch, watched=kind == "unplug")
    Path("plan.toml").write_text(f'[[fault]]\nkind = "{kind}"\nat = 1.0\ncount = 50\n')
    given = ["record", "--backend", "sim", "--duration", "2", "--faults", "plan.toml", "-o", "a.h5"]
    if status is None:
        assert exit_status(copied(lambda: cli.run(given))) == -signal.SIGKILL
        with Recording(Path("a.h5.part")) as recording:
            assert 450 <= len(recording) <= 500
        return
    assert cli.run(given) == status
    assert words in capfd.readouterr().err
    with Recording(Path("a.h5")) as recording:
        assert not recording.complete
        assert 450 <= len(recording) <= 750
    servo.clock.sleep_until(servo.clock.now() + 0.1)  # only the watchdog can stop a motor whose link is gone
    assert not servo.true_state().enabled


def test_a_disk_that_does_not_answer_in_virtual_time_is_refused_before_anything_moves(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plan.toml").write_text('[[fault]]\nkind = "disk-frozen"\nat = 1.0\n')
    assert cli.run(["record", "--backend", "sim", "--faults", "plan.toml", "-o", "a.h5"]) == 2
    assert "add --realtime" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["plan.toml"]


def test_a_run_whose_file_is_gone_says_where_its_rows_are_or_that_none_can_be_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Its name was taken meanwhile, while a fault ended it; its file was cut off."""
    finished = RecordingWriter.finish
    monkeypatch.chdir(tmp_path)
    Path("plan.toml").write_text('[[fault]]\nkind = "over-temperature"\nat = 0.5\n')
    words = ["record", "--backend", "sim", "--duration", "1", "-o"]
    for happens, name, more, status, said in (
        (
            lambda writer: writer.final.write_text("mine"),
            "a.h5",
            ["--faults", "plan.toml"],
            4,
            ("winding reached 150", "a.h5 exists", "hil recover a.h5.part -o OTHER.h5"),
        ),
        (lambda writer: os.truncate(writer.path, 1000), "b.h5", [], 2, ("no row that can be read",)),
    ):

        def finish(
            writer: RecordingWriter, end_reason: str, *, force: bool = False, happens: Callable[..., Any] = happens
        ) -> Path:
            happens(writer)
            return finished(writer, end_reason, force=force)

        monkeypatch.setattr(RecordingWriter, "finish", finish)
        assert cli.run([*words, name, *more]) == status
        err = capfd.readouterr().err
        assert all(part in err for part in said)
        assert "is safe" not in err or status == 4
    assert Path("a.h5").read_text() == "mine"


def test_faults_are_planned_for_a_simulated_stand_only(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "stand.toml").write_text(
        STAND.text.replace('"sim"', '"odrive"')
        + '[odrive]\ninterface = "slcan"\nchannel = "x"\ntorque_constant = 1.0\n'
    )
    (tmp_path / "plan.toml").write_text('[[fault]]\nkind = "drop"\nat = 1\n')
    words = ["--stand", str(tmp_path / "stand.toml"), "--faults", str(tmp_path / "plan.toml")]
    assert cli.run(["record", *words]) == 2
    assert "hil emulate NAME --faults" in capfd.readouterr().err


# --- names on disk ---------------------------------------------------------------------------------------------------


def test_a_recording_in_progress_is_not_taken_over_even_with_force(spring: SpringServo) -> None:
    with RecordingWriter(Path("a.h5"), Header(profile={}), 5) as part:
        assert record("-o", "a.h5", "--force") == 2
        assert part.path.exists()
    assert spring.driven == []
    assert record("-o", "a.h5") == 2
    assert record("-o", "a.h5", "--force") == 0


def test_an_unfinished_recording_outlives_a_command_that_cannot_begin(spring: SpringServo) -> None:
    with RecordingWriter(Path("a.h5"), Header(profile={}), 5) as part:
        pass
    assert record("-o", "a.h5", "--force", "--amplitude", "99") == 2
    assert part.path.exists()
    assert spring.driven == []


def test_recorders_that_start_at_once_use_different_names(
    spring: SpringServo, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """One saw run1 free as we did and records; another was faster still and has ended."""
    folder = tmp_path / "recordings"
    folder.mkdir()
    names = iter(["run1.h5", "run2.h5", "run3.h5"])
    monkeypatch.setattr(run_module, "next_free", lambda _: folder / next(names))
    (folder / "run2.h5").write_text("finished meanwhile")
    with RecordingWriter(folder / "run1.h5", Header(profile={}), 5) as other:
        assert record() == 0
        assert other.path.exists()
    assert sorted(item.name for item in folder.iterdir()) == ["run1.h5.part", "run2.h5", "run3.h5"]
    assert (folder / "run2.h5").read_text() == "finished meanwhile"
    assert not spring.armed


@pytest.mark.parametrize("over", [0.99, 1.01])
def test_a_run_that_exceeds_a_limit_by_one_percent_is_complete_names_it_and_is_not_trusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], over: float
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["--profile", "sine", "--band", "2", "--duration", "4", "--amplitude", "0.005"]
    assert cli.run(["record", "--backend", "sim", *words, "-o", "a.h5"]) == 0
    with Recording(tmp_path / "a.h5") as recording:
        limit = float(np.abs(recording.channel("dtheta")).max()) / over
        rows = len(recording)
    Path("stand.toml").write_text(SIMULATED.replace("deflection = 1.0", f"deflection = {limit}"))
    assert cli.run(["record", "--stand", "stand.toml", *words, "-o", "b.h5"]) == int(over > 1.0)
    said = " ".join(capfd.readouterr().err.split())
    assert ("[over-limit]" in said) == ("the deflection was above its limit" in said) == (over > 1.0)
    with Recording(tmp_path / "b.h5") as recording:
        assert len(recording) == rows


# --- lateness --------------------------------------------------------------------------------------------------------


@pytest.mark.study
@pytest.mark.parametrize("late", [(5, 1, "error"), (20, 0, "warning")])
def test_a_run_whose_ticks_come_late_is_not_taken_for_a_good_one(
    spring: SpringServo, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], late: tuple[int, int, str]
) -> None:
    every, status, message = late
    exchange = spring.exchange

    def sometimes_late(command: Command) -> Sample:
        if spring.armed and len(spring.driven) % every == 0:
            spring.clock.t += 0.006
        return exchange(command)

    monkeypatch.setattr(spring, "exchange", sometimes_late)
    assert record("-o", "a.h5", "--duration", "3") == status
    assert capfd.readouterr().err.startswith(f"{message} [many-late]" if message else "")
    seen = cli.run(["inspect", "a.h5"])
    assert seen == status
    assert ("[many-late]" in capfd.readouterr().err) == bool(message)


@pytest.mark.parametrize(("rate", "message"), [("19", "between 20 and 10000"), ("5000", "lower the rate")])
def test_a_rate_no_drive_or_not_this_one_can_keep_is_wrong_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], rate: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.run(["record", "--backend", "sim", "--rate", rate, "--band", "0.5:2", "-o", "a.h5"]) == 2
    assert message in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.study
def test_a_rate_the_servo_cannot_quite_keep_ends_in_a_run_not_to_be_trusted_and_the_lowest_in_a_good_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A round trip of 0.6 ms in a period of 0.5 ms."""
    monkeypatch.chdir(tmp_path)
    assert cli.run(["record", "--backend", "sim", "--rate", "2000", "--duration", "1", "-o", "a.h5"]) == 1
    assert "many-late" in capfd.readouterr().err
    with Recording(tmp_path / "a.h5") as recording:
        assert len(recording) == 2001
    assert cli.run(["record", "--backend", "sim", "--rate", "20", "--band", "0.5:2", "-o", "b.h5"]) == 0


def test_an_interrupted_torque_off_is_retried_until_the_silence_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    servo = simulated(monkeypatch)
    stand = parse(
        '[stand]\nbackend = "sim"\ngear_ratio = 4.0\ntorque_source = "joint"\n'
        "[limits]\ntorque = 0.03\ndeflection = 1.0\nvelocity = 100.0\n"
    )
    made = excitation.make(
        "sine", Quantity.TORQUE, amplitude=0.005, default_amplitude=1.0, duration=4.0, band=(2.0, 2.0), rate=500.0
    )
    faults = FaultPlan([PlannedFault("drop-request", at=1.0, duration=0.06)])
    outcome = run(stand, made, rate=500.0, seed=0, output=Path("a.h5"), faults=faults)[1]
    assert isinstance(outcome.error, NoReply)
    assert outcome.alarm == ""
    assert not servo.true_state().enabled
    assert servo.clock.now() < 1.1  # before the watchdog would have done it


def simulated(monkeypatch: pytest.MonkeyPatch, *, watched: bool = True) -> SimServo:
    """The simulated servo that every stand opens. watched: whether its watchdog works."""
    servo = SimServo(SimParameters(), seed=1, clock=VirtualClock(), watched=watched)
    monkeypatch.setattr(run_module, "open_servo", lambda *_, **__: (servo, {}))
    return servo
