"""A drive that is not the simulator, from its stand file to a recording: over the emulator's wire, in real time."""

from __future__ import annotations

import inspect
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import serial

from drivers.dynamixel.wire import Wire2
from drivers.packets.wire import WRITE
from hil.cli.app import run
from hil.recording.reader import Recording
from hil.signals.prepare import prepare
from hil.stand.file import load
from sim_backend.wire.catalogue import EMULATORS, Emulator, make
from sim_backend.wire.dynamixel.emulator import serve

from ...drivers.conftest import STAND

pytestmark = pytest.mark.usefixtures("busy_machine")


def stand_file(folder: Path, text: str = STAND) -> Path:
    path = folder / "stand.toml"
    path.write_text(text.format(port=folder / "ttyDXL"))
    return path


@contextmanager
def emulated(*words: str) -> Iterator[subprocess.Popen[str]]:
    """`hil emulate` as a person starts it, once it is ready."""
    code = "from hil.cli.app import main; main()"
    with subprocess.Popen(
        [sys.executable, "-c", code, "emulate", *words], stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stderr is not None
            assert process.stderr.readline().startswith(f"Emulating {EMULATORS[words[0]].noun}")
            yield process
        finally:
            process.kill()


@pytest.mark.study
def test_a_chirp_is_recorded_from_a_drive_served_by_another_command(tmp_path: Path) -> None:
    stand = stand_file(tmp_path)
    recording = tmp_path / "run.h5"
    link = tmp_path / "ttyDXL"
    with emulated("dynamixel", "--link", str(link), "--id", "1", "--id", "2", "--stand", str(stand)) as process:
        words = ["--profile", "chirp", "--band", "0.5:5", "--duration", "2", "--fade", "0.5", "--rate", "100"]
        assert run(["record", "--stand", str(stand), *words, "--amplitude", "0.01", "-o", str(recording)]) == 0
        process.send_signal(signal.SIGINT)
        assert process.wait(20.0) == 0
    assert not link.is_symlink()
    with Recording(recording) as made:
        signals = prepare(made, load(stand).stand)
    design = np.column_stack([signals.motion.dtheta, signals.motion.dtheta_dot])
    kc = float(np.linalg.lstsq(design, signals.coupling_torque, rcond=None)[0][0])
    assert kc == pytest.approx(17.75e-3, rel=0.1)


@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "limit", "inertia", "table"),
    [
        ("odrive", 2.0, None, "torque_constant = 0.04\nbitrate = 1000000"),
        ("mit", 10.0, 1.8e-3, 'model = "dm-j4310"'),
        ("robstride", 14.0, 1e-3, 'model = "rs00"'),
        ("moteus", 5.0, None, ""),
        ("cia402", 0.09, None, 'profile = "epos4"'),
    ],
)
def test_a_drive_on_can_is_recorded_over_a_serial_adapter(
    tmp_path: Path, name: str, limit: float, inertia: float | None, table: str
) -> None:
    """The joint behind each turns by 0.5 rad under a fifth of the drive's torque limit, N m. inertia: of a rotor whose
    data sheet states it, kg m^2; None: the paper's in proportion.

    A set-point that a busy machine sends late holds the torque for longer: the limit on the speed allows for that.
    """
    stiffness = 0.2 * limit / 0.5
    scale = stiffness / 17.75e-3
    link, stand, recording = tmp_path / "ttyCAN", tmp_path / "stand.toml", tmp_path / "run.h5"
    stand.write_text(
        f'[stand]\nbackend = "{name}"\nmotor_inertia = {inertia or 3.2e-6 * scale}\nmotor_damping = {1.6e-6 * scale}\n'
        f"torque_stays_on_if_host_dies = {str(name == 'odrive').lower()}\n"
        f"[limits]\ntorque = {0.03 * scale}\ndeflection = 1.5\nvelocity = 100.0\ntemperature = 75.0\n"
        f'[{name}]\ninterface = "slcan"\nchannel = "{link}"\nreply_timeout = 0.3\nwatchdog = 1.0\n{table}\n'
    )
    words = ["--profile", "chirp", "--band", "1:5", "--duration", "1.2", "--fade", "0.3", "--rate", "50"]
    served = make(name, {"link": link})
    thread = threading.Thread(target=served.serve)
    thread.start()
    try:
        assert (
            run(["record", "--stand", str(stand), *words, "--amplitude", f"{0.01 * scale}", "-o", str(recording)]) == 0
        )
    finally:
        served.stop()
        thread.join()
    with Recording(recording) as made:
        signals = prepare(made, load(stand).stand)
    design = np.column_stack([signals.motion.dtheta, signals.motion.dtheta_dot])
    kc = float(np.linalg.lstsq(design, signals.coupling_torque, rcond=None)[0][0])
    assert kc == pytest.approx(stiffness, rel=0.1)


@pytest.mark.study
def test_a_kill_ends_an_emulator_cleanly(tmp_path: Path) -> None:
    link = tmp_path / "ttyDXL"
    with emulated("dynamixel", "--link", str(link), "--model", "mx-64") as process:
        assert link.is_symlink()
        process.terminate()
        assert process.wait(20.0) == 0
    assert not link.is_symlink()


@pytest.mark.study
def test_a_position_profile_puts_the_drive_into_a_position_mode(tmp_path: Path) -> None:
    stand = stand_file(tmp_path, STAND.replace("torque = 0.03", "torque = 0.3"))
    recording = tmp_path / "run.h5"
    words = ["--profile", "sine", "--band", "2", "--duration", "0.75", "--fade", "0.125", "--rate", "50"]
    with serve(tmp_path / "ttyDXL", "xl330-m288"):
        words += ["--mode", "position", "--amplitude", "0.3", "-o", str(recording)]
        assert run(["record", "--stand", str(stand), *words]) == 0
    with Recording(recording) as made:
        command, dtheta = made.channel("command"), made.channel("dtheta")
    answered = np.isfinite(dtheta)  # a busy machine loses a reply now and then
    assert np.ptp(dtheta[answered]) == pytest.approx(np.ptp(command), rel=0.2)


@pytest.mark.parametrize("belongs", [False, True])
def test_beside_a_servo_that_holds_torque_nothing_is_driven_unless_the_stand_file_names_it(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], belongs: bool
) -> None:
    stand = stand_file(tmp_path)
    if belongs:
        stand.write_text(stand.read_text().replace("[limits]", "holding_ids = [2]\n[limits]"))
    with serve(tmp_path / "ttyDXL", idents=(1, 2)) as line:
        with serial.Serial(str(line.link), 1_000_000, timeout=5.0) as port:
            port.write(Wire2().frame(2, WRITE, bytes([64, 0, 1])))
            assert len(port.read(11)) == 11
        words = ["--band", "1:5", "--duration", "0.6", "--fade", "0.1", "--rate", "50", "--amplitude", "0.005"]
        assert run(["record", "--stand", str(stand), *words, "-o", str(tmp_path / "a.h5")]) == (0 if belongs else 2)
        assert (tmp_path / "a.h5").exists() == belongs
        assert run(["doctor", str(stand), "--rate", "50"]) == (0 if belongs else 3)
        said = capfd.readouterr()
        for text in (said.err, said.out) if not belongs else ():
            assert "drive 2 on the same bus (xl330-m288)" in " ".join(text.split())
            assert "write 0 to its Torque Enable(64)" in " ".join(text.split())
        assert ("armed at zero torque" in said.out) == belongs
        bus: Any = line._peer
        own, other = bus.devices
        assert other.motor.enabled
        assert not own.motor.enabled


def test_record_without_a_drive_at_the_port_fails_as_a_stand_does_and_says_what_to_do(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(["record", "--stand", str(stand_file(tmp_path)), "-o", str(tmp_path / "run.h5")]) == 3
    assert "there is no such port" in capfd.readouterr().err
    assert not (tmp_path / "run.h5").exists()


def test_the_backends_and_the_emulators_are_listed(capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["record", "--list-backends"]) == 0
    assert re.findall(r"^\w+", capfd.readouterr().out, re.MULTILINE)[:2] == ["sim", "dynamixel"]
    assert run(["emulate"]) == 0
    assert re.findall(r"^\w+", capfd.readouterr().out, re.MULTILINE) == list(EMULATORS)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["dynamixle"], "did you mean 'dynamixel'"),
        (["dynamixel"], "needs --link"),
        (["dynamixel", "--link", "x", "--bus", "slcan"], "takes no --bus: it takes --link, --model, --id"),
        (["dynamixel", "--link", "x", "--model", "xl1"], "choose one of mx-106"),
        (["dynamixel", "--link", "x", "--id", "1", "--id", "1"], "ids must differ"),
        (["dynamixel", "--link", "x", "--baudrate", "1000"], "choose one of 9600"),
        (["dynamixel", "--link", "."], "is not a link"),
    ],
)
def test_an_emulator_that_cannot_be_is_refused_in_a_sentence(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["emulate", *words]) == 2
    assert said in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", EMULATORS)
def test_an_emulators_function_takes_options_of_the_command_only(name: str) -> None:
    options = {
        "link",
        "channel",
        "interface",
        "model",
        "firmware",
        "idents",
        "baudrate",
        "parameters",
        "hand",
        "log",
        "faults",
    }
    taken = set(inspect.signature(EMULATORS[name].function()).parameters)
    assert taken <= options | {"timing"}
    assert ("timing" in taken) == bool(EMULATORS[name].timing)


class Wire:
    """What stands for the times of a wire."""


def serve_on_can(
    channel: str | Path,
    firmware: str = "0.6",
    idents: Iterable[int] = (0,),
    *,
    interface: str = "slcan",
    timing: Wire | None = None,
) -> tuple[object, ...]:
    if firmware == "0.1":
        raise RuntimeError("no such bus")
    return str(channel), firmware, list(idents), interface, type(timing)


@pytest.fixture
def can(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("a_can_drive")
    module.__dict__.update(serve=serve_on_can, Wire=Wire)
    monkeypatch.setitem(sys.modules, "a_can_drive", module)
    monkeypatch.setattr(
        "sim_backend.wire.catalogue.EMULATORS",
        {"drive": Emulator("a drive", "on CAN", "a_can_drive:serve", "a_can_drive:Wire")},
    )


@pytest.mark.usefixtures("can")
def test_the_options_go_to_the_parameters_of_an_emulator_by_name() -> None:
    options = {"link": Path("ttyCAN"), "bus": "slcan", "idents": [1, 2]}
    assert make("drive", options) == ("ttyCAN", "0.6", [1, 2], "slcan", Wire)  # type: ignore[comparison-overlap]  # a stand-in
    options = {"channel": "239.0.0.1", "bus": "udp_multicast", "instant": True}
    assert make("drive", options) == ("239.0.0.1", "0.6", [0], "udp_multicast", type(None))  # type: ignore[comparison-overlap]  # a stand-in


@pytest.mark.usefixtures("can")
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, r"needs --link \(or --channel\)"),
        ({"link": Path("x"), "model": "y"}, "takes no --model: it takes --link"),
        ({"link": Path("x"), "firmware": "0.1"}, "hil emulate drive: no such bus"),
    ],
)
def test_what_an_emulator_raises_is_told_in_a_sentence(options: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make("drive", options)


@pytest.mark.study
def test_a_run_in_real_time_ends_with_the_lateness_of_its_set_points(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, busy_machine: None
) -> None:
    del busy_machine
    words = ["record", "--backend", "sim", "--duration", "0.3", "--rate", "100", "--fade", "0.1", "-o"]
    assert run([*words, str(tmp_path / "a.h5"), "--realtime"]) == 0
    said = capfd.readouterr().out.splitlines()[-1]
    assert re.fullmatch(r"set-points late by .*s \(median\), .*s \(99 %\), .*s at most; \d+ ticks missed", said)
    assert run([*words, str(tmp_path / "b.h5"), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["lateness"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


IN_THE_BACKGROUND = """
emulator=$("$0" -c 'from hil.cli.app import main; main()' emulate commander --link ./tty --background)
test -c ./tty && echo "$emulator"
"""


def in_a_session_of_its_own(script: str, folder: Path) -> str:
    words = ["bash", "-c", script, sys.executable]
    return subprocess.run(
        words, cwd=folder, start_new_session=True, capture_output=True, text=True, check=True
    ).stdout.strip()


def gone(process: int) -> bool:
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.01)
    return False


@pytest.mark.study
def test_an_emulator_in_the_background_has_its_port_when_the_command_returns_and_ends_with_its_session(
    tmp_path: Path,
) -> None:
    process = int(in_a_session_of_its_own(IN_THE_BACKGROUND, tmp_path))
    assert gone(process)
    assert not (tmp_path / "tty").is_symlink()


@pytest.mark.study
def test_an_emulator_in_the_background_ends_by_its_id_and_leaves_the_link_of_the_next_one(tmp_path: Path) -> None:
    script = f"{IN_THE_BACKGROUND}first=$emulator{IN_THE_BACKGROUND}kill $first\nwhile kill -0 $first; do :; done\n"
    first, second = in_a_session_of_its_own(f"{script}test -c ./tty && kill $emulator", tmp_path).split()
    assert gone(int(first))
    assert gone(int(second))
