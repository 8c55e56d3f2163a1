"""What `hil inspect` says of a recording: every threshold from both sides."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import h5py
import numpy as np
import pytest

from drivers.servo import Status
from hil.errors import Untrustworthy
from hil.recording.reader import Array, Recording
from hil.recording.writer import Header, write
from hil.signals.defects import Defects
from hil.signals.inspection import inspect
from hil.signals.prepare import prepare
from hil.signals.quality import Quality, recording_diagnostics

from ..conftest import Maker


def codes(make_recording: Maker, **settings: object) -> dict[str, bool]:
    """Code of each diagnostic, and whether it is an error."""
    return {diagnostic.code: diagnostic.is_error for diagnostic in inspect(make_recording(**settings)).diagnostics}


GOOD = Quality(
    2000, Defects(), 0, 0, "joint", torque=0.1, deflection=1.0, deflection_lsb=1e-3, torque_noise=1e-4, snr=60.0
)


def said(**changes: Any) -> dict[str, bool]:
    """Code of each diagnostic about a quality, and whether it is an error."""
    recording = SimpleNamespace(imported=False, complete=True, profile={})
    found = recording_diagnostics(cast("Recording", recording), replace(GOOD, **changes), None)
    return {one.code: one.is_error for one in found}


LIMITS_OF_WARNINGS = [
    ("saturated", 20, "saturated", None),
    ("saturated", 21, "saturated", False),
    ("late", 20, "many-late", None),
    ("late", 21, "many-late", False),
    ("late", 200, "many-late", False),
    ("late", 201, "many-late", True),
    ("snr", 20.0, "poor-snr", None),
    ("snr", 19.9, "poor-snr", False),
    ("snr", 3.0, "poor-snr", False),
    ("snr", 2.9, "poor-snr", True),
    ("deflection_lsb", 1.0 / 20.0, "deflection-noise", None),
    ("deflection_lsb", 1.0 / 19.9, "deflection-noise", False),
    ("deflection_lsb", 1.0 / 3.0, "deflection-noise", False),
    ("deflection_lsb", 1.0 / 2.9, "deflection-noise", True),
    ("defects", Defects(lost=20), "lost-samples", None),
    ("defects", Defects(lost=21), "lost-samples", False),
    ("defects", Defects(not_numbers=1), "invalid-readings", False),
    ("defects", Defects(near_gaps=1), "unknown-rate", False),
    ("defects", Defects(coarse_clock=True), "coarse-clock", False),
    ("defects", Defects(frozen=1), "invalid-readings", False),
    ("defects", Defects(clipped=1), "invalid-readings", False),
    ("defects", Defects(spikes=1), "invalid-readings", False),
    ("defects", Defects(wrong_torques=(-1.0,)), "invalid-readings", False),
    ("defects", Defects(wraps=1), "angle-wrapped", False),
    ("defects", Defects(jerked=100), "unknown-rate", None),
    ("defects", Defects(jerked=101), "unknown-rate", False),
]


def test_what_is_wrong_with_a_recording_is_told_from_a_share_on() -> None:
    assert said() == {}
    for name, value, code, is_error in LIMITS_OF_WARNINGS:
        assert said(**{name: value}) == ({} if is_error is None else {code: is_error}), (name, value)


def test_rows_that_were_not_ordinary_are_counted(make_recording: Maker) -> None:
    def change(channels: dict[str, Array]) -> None:
        channels["status"] = np.zeros(len(channels["time"]))
        for status, rows in ((Status.SATURATED, 30), (Status.NO_REPLY, 45), (Status.LATE, 25)):
            channels["status"][100 * np.arange(rows) % 1999 + 1] += float(int(status))
        lost = channels["status"].astype(int) & int(Status.NO_REPLY) > 0
        channels["torque"][lost] = channels["dtheta"][lost] = np.nan

    found = inspect(make_recording(change=change))
    assert (found.saturated, found.lost, found.late) == (30, 45, 25)
    assert {"saturated", "lost-samples", "many-late"} <= {one.code for one in found.diagnostics}


@pytest.mark.parametrize("ratio", [1.5])
def test_the_ratio_of_torque_to_noise_is_that_of_their_variances(make_recording: Maker, ratio: float) -> None:
    """In dB, the torque's with the noise."""
    with Recording(make_recording()) as recording:
        power = float(np.var(recording.channel("torque")))
    noise = float(np.sqrt(power / (10.0 ** (ratio / 10.0) - 1.0)))
    found = inspect(make_recording(noise=noise, samples=4000))
    assert found.snr == pytest.approx(ratio, abs=0.5)
    assert found.torque_noise == pytest.approx(noise, rel=0.05)


def test_the_count_of_the_deflection_is_the_smallest_step_between_its_readings(make_recording: Maker) -> None:
    steps = []

    def coarse(channels: dict[str, Array]) -> None:
        steps.append(float(np.ptp(channels["dtheta"])) / 18.0)
        channels["dtheta"] = np.round(channels["dtheta"] / steps[0]) * steps[0]

    found = inspect(make_recording(noise=1e-5, change=coarse))
    assert found.deflection_lsb == pytest.approx(steps[0], rel=1e-6)
    assert "deflection-noise" in {one.code for one in found.diagnostics}


def test_samples_that_were_altered_are_not_measured(make_recording: Maker) -> None:
    path = make_recording()
    with h5py.File(path, "r+") as file:
        file["samples"]["torque"][7] += 1e-9
    with pytest.raises(Untrustworthy, match="SHA-256 differs"):
        inspect(path)


@pytest.mark.parametrize(("missing", "dropped"), [(-1, False), (1, True)])
def test_a_window_may_span_a_gap_of_half_its_width_and_no_more(
    make_recording: Maker, missing: int, dropped: bool
) -> None:
    """A window of 2h periods may reach over half as much again: h-1 rows lost in a row leave it sound, h+1 do not."""
    with Recording(make_recording()) as recording:
        half = round(float(prepare(recording, None).motion.time[0]) * 500.0)  # the widest window is not whole before
    assert half > 3

    def lose(channels: dict[str, Array]) -> None:
        chosen = slice(1000, 1000 + half + missing)
        channels["status"] = np.zeros(2000)
        channels["status"][chosen] = float(int(Status.NO_REPLY))
        channels["dtheta"][chosen] = channels["torque"][chosen] = np.nan

    with Recording(make_recording(change=lose)) as recording:
        signals = prepare(recording, None)
    assert signals.defects.lost == half + missing
    assert (signals.defects.near_gaps > 0) == dropped


@pytest.mark.study
@pytest.mark.parametrize(("kind", "advice"), [("imported", "record a larger motion"), ("chirp", "(--amplitude)")])
def test_an_option_of_hil_record_is_no_advice_for_an_imported_recording(tmp_path: Path, kind: str, advice: str) -> None:
    time = np.arange(2000) / 500.0
    dtheta, noise = 0.1 * np.sin(20.0 * time), 0.01 * np.random.default_rng(0).standard_normal(2000)
    coarse = {"time": time, "torque": 0.1 * dtheta + noise, "dtheta": 0.02 * np.round(dtheta / 0.02)}
    write(tmp_path / "a.h5", Header(profile={"kind": kind}, stand_toml=""), coarse)
    said = {one.code: one.message for one in inspect(tmp_path / "a.h5").diagnostics}
    for code in ("deflection-noise", "poor-snr"):
        assert said[code].endswith(advice)
        assert "record a larger motion" in said[code]
    write(tmp_path / "b.h5", Header(profile={"kind": kind}, stand_toml=""), coarse | {"dtheta": np.full(2000, 0.1)})
    with pytest.raises(Untrustworthy, match="never changes") as refused:
        inspect(tmp_path / "b.h5")
    assert ("--amplitude" in str(refused.value)) == (kind != "imported")


@pytest.mark.parametrize(("sign", "said"), [(-1.0, {"implausible": True}), (1.0, {})])
def test_a_wrong_sign_makes_a_recording_unusable(make_recording: Maker, sign: float, said: dict[str, bool]) -> None:
    def change(channels: dict[str, Array]) -> None:
        channels["torque"] *= sign

    found = inspect(make_recording(noise=1e-4, change=change))
    assert {one.code: one.is_error for one in found.diagnostics} == said
    assert found.usable is (sign > 0.0)


@pytest.mark.parametrize(("stiffness", "damping", "wrong"), [(-0.02, -2e-4, True), (-0.02, 2e-4, False)])
def test_at_one_frequency_an_inertia_is_no_wrong_sign(
    make_recording: Maker, stiffness: float, damping: float, *, wrong: bool
) -> None:
    def change(channels: dict[str, Array]) -> None:
        speed = 20.0
        angle, rate = 0.2 * np.sin(speed * channels["time"]), 0.2 * speed * np.cos(speed * channels["time"])
        noise = 1e-4 * np.random.default_rng(0).standard_normal(len(angle))
        channels |= {"dtheta": angle, "torque": stiffness * angle + damping * rate + noise}

    assert ("implausible" in codes(make_recording, change=change)) is wrong


@pytest.mark.study
def test_a_pause_changes_no_figure_but_its_own(tmp_path: Path) -> None:
    pause = 1.7e9  # a clock that is set
    rng, time = np.random.default_rng(0), np.arange(2000) / 500.0
    dtheta = np.sum([0.1 * np.sin(2.0 * np.pi * f * time + f) for f in (0.7, 2.1, 5.3)], axis=0)
    torque = 0.5 * dtheta + 0.03 * rng.standard_normal(len(time))
    seen = []
    for length in (0.0, pause):
        channels = {"time": time + length * (time >= 2.0), "torque": torque, "dtheta": dtheta}
        write(tmp_path / "a.h5", Header(profile={"kind": "imported"}), channels, force=True)
        seen.append(inspect(tmp_path / "a.h5"))
    whole, paused = seen
    assert paused.torque_noise == pytest.approx(whole.torque_noise, rel=0.05)
    assert paused.snr == pytest.approx(whole.snr, abs=1.0)
    assert paused.band == pytest.approx(whole.band, rel=0.5)
    assert paused.longest_gap == pytest.approx(pause + 0.002)
    assert {one.code for one in whole.diagnostics} == {one.code for one in paused.diagnostics} - {"unknown-rate"}
