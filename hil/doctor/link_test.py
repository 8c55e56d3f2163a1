"""Listening to a drive at rest: how fast and how evenly its link answers, and what its sensors say."""

from __future__ import annotations

import math

import numpy as np

from drivers.servo import BadReply, Command, NoReply, Sample, Servo
from hil.acquisition.interrupt import StopRequest
from hil.doctor.checks import BusFigures, Examination, Verdict
from hil.stand.file import Stand

_SECONDS = 1.0
_MOST = 20_000  # exchanges in that time, however fast they are
_MANY_LOST = 0.02
_MARGIN = 1.1  # of the rate wanted that the link must manage


def listen(found: Examination, servo: Servo, rate: float, stop: StopRequest) -> list[Sample]:
    """A second of round trips as fast as they go, without torque; the link is judged by `rate` Hz.

    Raises what `exchange` does, but for lost and bad replies, which are counted.
    """
    clock, lost = servo.clock, 0
    trips: list[float] = []
    samples: list[Sample] = []
    begin = clock.now()
    while clock.now() - begin < _SECONDS and len(trips) + lost < _MOST and not stop.count:
        before = clock.now()
        try:
            samples.append(servo.exchange(Command.rest()))
            trips.append(clock.now() - before)
        except (NoReply, BadReply):
            lost += 1
    seconds = max(clock.now() - begin, 1e-9)
    if samples:
        median, p99 = (float(value) for value in np.quantile(trips, (0.5, 0.99)))
        found.bus = BusFigures(len(samples), lost, len(samples) / seconds, median, p99, max(trips))
        _judge_bus(found, found.bus, rate)
    else:
        found.add("bus", Verdict.PROBLEM, f"{lost} requests, no reply: check power and cable")
    return samples


def manageable(bus: BusFigures, rate: float) -> int:
    """`rate` Hz, or the highest whole one that the link manages with a margin."""
    return max(1, min(int(rate), int(bus.rate / _MARGIN)))


def _judge_bus(found: Examination, bus: BusFigures, rate: float) -> None:
    figures = (
        f"{bus.exchanges} round trips, {bus.lost} lost; {bus.rate:.0f} a second; {bus.median * 1e3:.2f} ms each, "
        f"99 % below {bus.p99 * 1e3:.2f} ms, longest {bus.longest * 1e3:.2f} ms"
    )
    if bus.lost > _MANY_LOST * (bus.lost + bus.exchanges):
        more = "too many are lost; check cable, baud rate and other programs"
        found.add("bus", Verdict.PROBLEM, f"{figures}: {more}")
    elif bus.rate < _MARGIN * rate:
        more = f"too slow for {rate:.0f} Hz; record with --rate {manageable(bus, rate)}"
        found.add("bus", Verdict.NOTE, f"{figures}: {more}")
    else:
        found.add("bus", Verdict.OK, figures)


def judge_readings(found: Examination, stand: Stand, samples: list[Sample]) -> bool:
    """What the sensors say at rest; False where a recording could not be made of it."""
    names = ("motor_position", "motor_torque", "joint_torque", "temperature", "voltage")
    position, torque, joint, temperature, voltage = np.array([[getattr(s, name) for name in names] for s in samples]).T
    source = stand.stand.torque_source
    if not np.isfinite(position).all():
        found.add("readings", Verdict.PROBLEM, "the drive reports no position: a deflection cannot be recorded")
        return False
    if not np.isfinite(joint if source == "joint" else torque).any():
        more = ": add [joint_sensor]" if source == "joint" else ""
        said = f"torque_source = {source!r}, but no torque is reported there{more}"
        found.add("readings", Verdict.PROBLEM, said)
        return False
    words = [f"motor at {position[-1]:.4g} rad, noise {np.std(position) * 1e3:.2g} mrad"]
    for name, values in (("motor", torque), ("joint", joint)):
        if np.isfinite(values).any():
            words.append(f"{name} torque {np.nanmean(values) * 1e3:.3g} +- {np.nanstd(values) * 1e3:.2g} mN m")
    words += [f"{temperature[-1]:.0f} degC"] if math.isfinite(temperature[-1]) else []
    words += [f"{voltage[-1]:.1f} V"] if math.isfinite(voltage[-1]) else []
    found.add("readings", Verdict.OK, "; ".join(words))
    if stand.sensor is not None:
        _judge_sensor(found, samples)
    return True


def _judge_sensor(found: Examination, samples: list[Sample]) -> None:
    heard = [sample for sample in samples if math.isfinite(sample.t_joint)]
    if not heard:
        found.add("joint sensor", Verdict.PROBLEM, "it gave no reading: check its port, its baud rate and its power")
        return
    span = max(samples[-1].t_read - samples[0].t_read, 1e-9)
    rate = len({sample.t_joint for sample in heard}) / span
    age = float(np.median([sample.t_read - sample.t_joint for sample in heard]))
    found.add("joint sensor", Verdict.OK, f"{rate:.0f} readings a second, {age * 1e3:.1f} ms old when used")
