"""The link test: how fast and how evenly a drive at rest answers, and what its sensors read."""

from __future__ import annotations

import math

import numpy as np

from drivers.servo import BadReply, Command, NoReply, Sample, Servo
from hil.acquisition.interrupt import StopRequest
from hil.doctor.checks import CheckList, LinkFigures, Verdict
from hil.stand.file import Stand
from hil.stand.opening import slower_when_armed

_SECONDS = 1.0
_MOST = 20_000  # exchanges in that time, however fast they are
_MANY_LOST = 0.02
_MARGIN = 1.1  # of the requested rate that the link must reach


def check_link(checks: CheckList, servo: Servo, rate: float, stop: StopRequest) -> list[Sample]:
    """Read the servo without torque for one second, as fast as it answers, and compare the rate with `rate` Hz. Return
    the samples.

    Lost and bad replies are counted. Raises DriverError for any other fault.
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
        reached = 1.0 / (seconds / len(samples) + slower_when_armed(servo)[1])
        checks.bus = LinkFigures(len(samples), lost, reached, median, p99, max(trips))
        _check_figures(checks, checks.bus, rate)
    elif stop.count:
        checks.add("bus", Verdict.SKIPPED, "interrupted before the drive answered")
    else:
        checks.failed("bus", f"{lost} requests, no reply: check power and cable")
    return samples


def reachable(bus: LinkFigures, rate: float) -> int:
    """Return `rate` Hz if the link reaches it, otherwise the highest whole rate that the link reaches with a margin."""
    return max(1, min(int(rate), int(bus.rate / _MARGIN)))


def _check_figures(checks: CheckList, bus: LinkFigures, rate: float) -> None:
    figures = (
        f"{bus.exchanges} round trips, {bus.lost} lost; {bus.rate:.0f} a second; {bus.median * 1e3:.2f} ms each, "
        f"99 % below {bus.p99 * 1e3:.2f} ms, longest {bus.longest * 1e3:.2f} ms"
    )
    if bus.lost > _MANY_LOST * (bus.lost + bus.exchanges):
        checks.failed("bus", f"{figures}: too many are lost; check cable, baud rate and other programs")
    elif bus.rate < _MARGIN * rate:
        remedy = f"too slow for {rate:.0f} Hz; record with --rate {reachable(bus, rate)}"
        checks.add("bus", Verdict.WARNING, f"{figures}: {remedy}")
    else:
        checks.passed("bus", figures)


def check_readings(checks: CheckList, stand: Stand, samples: list[Sample]) -> bool:
    """Check the sensor readings at rest. Return False if no recording could be made with them."""
    names = ("motor_position", "motor_torque", "joint_torque", "temperature", "voltage")
    position, torque, joint, temperature, voltage = np.array([[getattr(s, name) for name in names] for s in samples]).T
    source = stand.stand.torque_source
    if not np.isfinite(position).all():
        checks.failed("readings", "the drive reports no position, so no deflection can be recorded: check its encoder")
        return False
    if not np.isfinite(joint if source == "joint" else torque).any():
        remedy = ": add [joint_sensor]" if source == "joint" else ""
        checks.failed("readings", f"torque_source = {source!r}, but no torque is read from it{remedy}")
        return False
    words = [f"motor at {position[-1]:.4g} rad, noise {np.std(position) * 1e3:.2g} mrad"]
    for name, values in (("motor", torque), ("joint", joint)):
        if np.isfinite(values).any():
            words.append(f"{name} torque {np.nanmean(values) * 1e3:.3g} +- {np.nanstd(values) * 1e3:.2g} mN m")
    words += [f"{temperature[-1]:.0f} degC"] if math.isfinite(temperature[-1]) else []
    words += [f"{voltage[-1]:.1f} V"] if math.isfinite(voltage[-1]) else []
    checks.passed("readings", "; ".join(words))
    if stand.sensor is not None:
        _check_sensor(checks, samples)
    return True


def _check_sensor(checks: CheckList, samples: list[Sample]) -> None:
    read = [sample for sample in samples if math.isfinite(sample.t_joint)]
    if not read:
        checks.failed("joint sensor", "the joint sensor gave no reading: check its port, its baud rate and its power")
        return
    span = max(samples[-1].t_read - samples[0].t_read, 1e-9)
    rate = len({sample.t_joint for sample in read}) / span
    age = float(np.median([sample.t_read - sample.t_joint for sample in read]))
    checks.passed("joint sensor", f"{rate:.0f} readings a second, {age * 1e3:.1f} ms old when used")
