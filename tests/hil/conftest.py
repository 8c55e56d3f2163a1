"""What the tests of `hil` share: a servo whose every reading is a closed form, and recordings made by hand."""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pytest

from drivers.servo import Command, Limits, NoReply, Quantity, Sample, ServoInfo, Status
from hil.cli.app import run
from hil.recording.integrity import header_hash, plain
from hil.recording.reader import Array
from hil.recording.writer import Header, write


class StillClock:
    """Time that passes only when someone waits for it; what happens at a moment can be planned."""

    def __init__(self) -> None:
        self.t = 100.0
        self.plans: list[tuple[float, Callable[[], None]]] = []

    def now(self) -> float:
        return self.t

    def sleep_until(self, t: float) -> None:
        self.t = max(self.t, t)
        for plan in [plan for plan in self.plans if plan[0] <= self.t]:
            self.plans.remove(plan)
            plan[1]()


@dataclass
class SpringServo:
    """A massless motor (gear ratio 4) on a spring of 2 N m/rad at the joint: deflection = torque/2, exactly.

    `script` maps the number of an exchange since arming to what happens in it: an error to raise, or a change to the
    sample. Every set-point that was driven is in `driven`. `disarm_error` is raised by every torque-off, or by those
    before the `heard_after`-th.
    """

    clock: StillClock = field(default_factory=StillClock)
    info: ServoInfo = field(default_factory=lambda: ServoInfo(backend="spring", model="closed form", watchdog=0.1))
    script: dict[int, Exception | dict[str, float]] = field(default_factory=dict)
    driven: list[Command] = field(default_factory=list)
    armed: bool = False
    limits: Limits | None = None
    disarms: int = 0
    disarm_error: BaseException | None = None
    heard_after: int = 0
    rest: dict[str, float] = field(default_factory=dict)
    motor_zero: float = 7.0

    def arm(self, limits: Limits) -> None:
        self.limits, self.armed = limits, True

    def exchange(self, command: Command) -> Sample:
        if not self.armed:
            assert command == Command.rest()
            return self._sample(0.0, self.rest)
        self.driven.append(command)
        planned = self.script.get(len(self.driven) - 1)
        if isinstance(planned, Exception):
            raise planned
        if command.quantity is Quantity.POSITION:
            joint_torque = 2.0 * (command.value - self.motor_zero) / 4.0
        else:
            joint_torque = 4.0 * command.value
        return self._sample(joint_torque, planned or {})

    def _sample(self, joint_torque: float, changes: dict[str, float]) -> Sample:
        readings: dict[str, float] = {
            "motor_position": self.motor_zero + 4.0 * joint_torque / 2.0,
            "motor_velocity": 0.0,
            "motor_torque": joint_torque / 4.0,
            "joint_torque": joint_torque,
            "temperature": 30.0,
        }
        saturated = Status(int((readings | changes).pop("status", 0)))
        kept = {name: value for name, value in (readings | changes).items() if name != "status"}
        return Sample(t=self.clock.now(), t_read=self.clock.now() + 1e-4, status=saturated, **kept)

    def disarm(self) -> None:
        self.disarms += 1
        if self.disarm_error is not None and (not self.heard_after or self.disarms < self.heard_after):
            raise self.disarm_error
        self.armed = False

    def close(self) -> None:
        self.armed = False


def lost(count: int, start: int) -> dict[int, Exception | dict[str, float]]:
    return {start + index: NoReply("nothing came") for index in range(count)}


Maker = Callable[..., Path]


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recordings that `make_recording` has written so far, by what they hold: a copy takes a tenth of the time."""
    return tmp_path_factory.mktemp("written")


def closed_form(
    *, samples: int = 2000, rate: float = 500.0, kc: float = 0.02, bc: float = 2e-4, noise: float = 0.0, seed: int = 0
) -> dict[str, Array]:
    """The channels of a linear joint that moves in two sines: torque = kc*dtheta + bc*rate + noise."""
    time = np.arange(samples) / rate
    slow, fast = 2.0 * math.pi * 1.3, 2.0 * math.pi * 7.1
    dtheta = 0.2 * np.sin(slow * time) + 0.1 * np.sin(fast * time)
    velocity = 0.2 * slow * np.cos(slow * time) + 0.1 * fast * np.cos(fast * time)
    torque = kc * dtheta + bc * velocity + noise * np.random.default_rng(seed).standard_normal(samples)
    return {"time": time, "torque": torque, "dtheta": dtheta}


@pytest.fixture
def make_recording(tmp_path: Path, written: Path) -> Maker:
    """Write a recording with a known answer: torque = kc*dtheta + bc*rate + noise, all in closed form."""

    def make(
        name: str = "a.h5",
        *,
        samples: int = 2000,
        rate: float = 500.0,
        kc: float = 0.02,
        bc: float = 2e-4,
        noise: float = 0.0,
        seed: int = 0,
        change: Callable[[dict[str, Array]], object] | None = None,
        stand: str = "",
    ) -> Path:
        path, kept = tmp_path / name, written / f"{hash((name, samples, rate, kc, bc, noise, seed, stand))}.h5"
        if change is None and kept.exists():
            shutil.copyfile(kept, path)
            return path
        channels = closed_form(samples=samples, rate=rate, kc=kc, bc=bc, noise=noise, seed=seed)
        if change is not None:
            change(channels)
        write(path, Header(profile={"kind": "imported"}, stand_toml=stand), channels, force=True)
        if change is None:
            shutil.copyfile(path, kept)
        return path

    return make


@contextmanager
def edited(path: Path) -> Iterator[h5py.File]:
    """Open a finished recording to change its header, and give it the hash of what it then holds."""
    with h5py.File(path, "r+") as file:
        yield file
        truth = {name: float(value) for name, value in file["truth"].attrs.items()} if "truth" in file else {}
        group = file["events"]
        texts = (group["code"].asstr()[()].tolist(), group["message"].asstr()[()].tolist())
        events = list(zip(group["time"][()].tolist(), *texts, strict=True))
        file.attrs["sha256_header"] = header_hash(plain(file.attrs), plain(file["profile"].attrs), truth, events)


def copied(work: Callable[[], int | None]) -> int:
    """Start a copy of this process that does `work` and ends with the status it returns; return its process id.

    A new process would import hil first, which takes a second.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the copy uses none of theirs
        child = os.fork()
    if child:
        return child
    status = 120
    try:
        status = work() or 0
    except BaseException:  # noqa: BLE001 - nothing of it may go on as a second pytest
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(status)


def exit_status(child: int) -> int:
    """Wait for a copy to end. Return its exit status, or the negative number of the signal that killed it."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


class Ended(NamedTuple):
    """How a command ended: its exit status, standard output and standard error."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.out)
        return found


Hil = Callable[..., Ended]


@pytest.fixture
def hil(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Hil:
    """Run a command in an empty folder, 80 characters wide, where standard error is no terminal."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")

    def call(*words: object) -> Ended:
        status = run([str(word) for word in words])
        return Ended(status, *capfd.readouterr())

    return call
