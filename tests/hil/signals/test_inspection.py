"""What `hil inspect` says of a recording: every threshold from both sides."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from drivers.servo import Status
from hil.errors import Untrustworthy
from hil.recording.reader import Array, Recording
from hil.recording.writer import Header, write
from hil.signals.inspection import inspect
from hil.signals.prepare import prepare

from ..conftest import Maker

Change = Callable[[dict[str, Array]], object]


def marked(share: float, status: Status) -> Change:
    """Every so many-th row with that status; what was not answered holds no reading."""

    def change(channels: dict[str, Array]) -> None:
        rows = len(channels["time"])
        chosen = np.linspace(50, rows - 50, round(share * rows)).astype(int)
        channels["status"] = np.zeros(rows)
        channels["status"][chosen] = float(int(status))
        if status is Status.NO_REPLY:
            channels["torque"][chosen] = channels["dtheta"][chosen] = np.nan

    return change


def codes(make_recording: Maker, **settings: object) -> dict[str, bool]:
    """Code of each diagnostic, and whether it is an error."""
    return {diagnostic.code: diagnostic.is_error for diagnostic in inspect(make_recording(**settings)).diagnostics}


@pytest.mark.parametrize(
    ("status", "share", "code", "is_error"),
    [
        (Status.SATURATED, 0.009, "saturated", None),
        (Status.SATURATED, 0.011, "saturated", False),
        (Status.NO_REPLY, 0.019, "many-lost", None),
        (Status.NO_REPLY, 0.021, "many-lost", False),
        (Status.LATE, 0.009, "many-late", None),
        (Status.LATE, 0.011, "many-late", False),
        (Status.LATE, 0.099, "many-late", False),
        (Status.LATE, 0.101, "many-late", True),
    ],
)
def test_rows_that_were_not_ordinary_are_told_from_a_share_on(
    make_recording: Maker, status: Status, share: float, code: str, is_error: bool | None
) -> None:
    assert codes(make_recording, change=marked(share, status)).get(code) is is_error


@pytest.mark.parametrize(("ratio", "is_error"), [(22.0, None), (18.0, False), (4.5, False), (1.5, True)])
def test_a_torque_near_its_noise_is_told(make_recording: Maker, ratio: float, is_error: bool | None) -> None:
    """The ratio in dB is the variance of the torque, noise included, over the noise's."""
    with Recording(make_recording()) as recording:
        power = float(np.var(recording.channel("torque")))
    noise = float(np.sqrt(power / (10.0 ** (ratio / 10.0) - 1.0)))
    path = make_recording(noise=noise, samples=20_000)
    assert inspect(path).snr == pytest.approx(ratio, abs=0.5)
    assert {item.code: item.is_error for item in inspect(path).diagnostics}.get("poor-snr") is is_error


@pytest.mark.parametrize(("counts", "is_error"), [(22, None), (18, False), (4, False), (2, True)])
def test_a_deflection_of_few_counts_is_told(make_recording: Maker, counts: int, is_error: bool | None) -> None:
    def coarse(channels: dict[str, Array]) -> None:
        low, high = channels["dtheta"].min(), channels["dtheta"].max()
        step = (high - low) / counts
        channels["dtheta"] = np.round((channels["dtheta"] - low) / step) * step

    assert codes(make_recording, noise=1e-5, change=coarse).get("few-counts") is is_error


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


@pytest.mark.parametrize(("kind", "advice"), [("imported", "record a larger motion"), ("chirp", "(--amplitude)")])
def test_an_option_of_hil_record_is_no_advice_for_an_imported_recording(tmp_path: Path, kind: str, advice: str) -> None:
    time = np.arange(2000) / 500.0
    dtheta, noise = 0.1 * np.sin(20.0 * time), 0.01 * np.random.default_rng(0).standard_normal(2000)
    coarse = {"time": time, "torque": 0.1 * dtheta + noise, "dtheta": 0.02 * np.round(dtheta / 0.02)}
    write(tmp_path / "a.h5", Header(profile={"kind": kind}, stand_toml=""), coarse)
    said = {one.code: one.message for one in inspect(tmp_path / "a.h5").diagnostics}
    for code in ("few-counts", "poor-snr"):
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

    assert codes(make_recording, noise=1e-4, change=change) == said
    assert inspect(make_recording(noise=1e-4, change=change)).usable is (sign > 0.0)


@pytest.mark.parametrize(
    ("stiffness", "damping", "wrong"), [(0.02, 2e-4, False), (-0.02, -2e-4, True), (-0.02, 2e-4, False)]
)
def test_at_one_frequency_an_inertia_is_no_wrong_sign(
    make_recording: Maker, stiffness: float, damping: float, *, wrong: bool
) -> None:
    def change(channels: dict[str, Array]) -> None:
        speed = 20.0
        angle, rate = 0.2 * np.sin(speed * channels["time"]), 0.2 * speed * np.cos(speed * channels["time"])
        noise = 1e-4 * np.random.default_rng(0).standard_normal(len(angle))
        channels |= {"dtheta": angle, "torque": stiffness * angle + damping * rate + noise}

    assert ("implausible" in codes(make_recording, change=change)) is wrong
