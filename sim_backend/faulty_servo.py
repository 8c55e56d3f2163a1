"""A servo with planned faults, which the recorder sees as if they came from the servo's driver."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import replace

from drivers.servo import BadReply, Command, DeviceFault, Limits, LinkLost, NoReply, Sample, Servo, Status
from sim_backend.fault_plan import DRIVE, HOST, LINK, FaultPlan, PlannedFault

_TIMEOUT = 0.008  # s after which a host takes a reply for lost
_GARBLED = frozenset({"flip", "truncate", "noise", "flood"})
_OLD = frozenset({"duplicate", "swap"})
_GONE = frozenset({"unplug", "bus-off"})


class FaultyServo:
    """The servo `servo` with the faults of `plan`, whose times are s since this object was made.

    on_host: a function that is called once with each fault of the computer.
    """

    def __init__(self, servo: Servo, plan: FaultPlan, on_host: Callable[[PlannedFault], object]) -> None:
        self.info, self.clock = servo.info, servo.clock
        self._servo = servo
        self._plan = plan
        self._on_host = on_host
        self._opened = servo.clock.now()
        self._number = 0
        self._happened: set[PlannedFault] = set()
        self._last: Sample | None = None
        self._stuck = math.nan

    def arm(self, limits: Limits) -> None:
        """See `Servo`."""
        self._pass_link()
        self._servo.arm(limits)

    def exchange(self, command: Command) -> Sample:
        """See `Servo`."""
        link = self._pass_link()
        for fault in self._acting(HOST):
            if fault not in self._happened:
                self._happened.add(fault)
                self._on_host(fault)
        sample = self._servo.exchange(command)
        drive = {fault.kind: fault for fault in self._acting(DRIVE)}
        if "error" in drive:
            self._servo.disarm()
            code = int(drive["error"].amount)
            raise DeviceFault(code, f"the drive latched fault {code}: it is planned in the file of --faults")
        return self._arrived(self._measured(sample, drive), link)

    def disarm(self) -> None:
        """See `Servo`."""
        self._pass_link()
        if not self._acting(("ignored-off",)):
            self._servo.disarm()

    def close(self) -> None:
        """See `Servo`. If a fault keeps torque-off from the drive, only the drive's watchdog can switch the torque
        off.
        """
        if not self._acting(("ignored-off", "drop-request", *_GONE)):
            self._servo.close()

    def _acting(self, kinds: Collection[str]) -> list[PlannedFault]:
        return self._plan.acting(kinds, self.clock.now() - self._opened, self._number)

    def _pass_link(self) -> dict[str, PlannedFault]:
        """Count a request. Return the faults of its reply by kind. Raises the error that the host sees if the request
        or the reply does not arrive.
        """
        self._number += 1
        acting = {fault.kind: fault for fault in self._acting(LINK)}
        if acting.keys() & _GONE:
            raise LinkLost("the link is gone, as planned: whether the motor is live is not known")
        if acting.keys() & {"drop-request", "reboot"}:
            self._time_out()
        return acting

    def _time_out(self) -> None:
        self.clock.sleep_until(self.clock.now() + _TIMEOUT)
        raise NoReply(f"no reply within {_TIMEOUT * 1e3:g} ms")

    def _arrived(self, sample: Sample, link: dict[str, PlannedFault]) -> Sample:
        """Return the sample as it arrives at the host under the link faults `link`."""
        last, self._last = self._last, sample
        if "drop" in link:
            self._time_out()
        if link.keys() & _GARBLED:
            raise BadReply("the reply failed its checksum: the sample is dropped")
        if "delay" in link:
            late = link["delay"].amount
            if late >= _TIMEOUT:
                self._time_out()
            self.clock.sleep_until(self.clock.now() + late)
        if link.keys() & _OLD and last is not None:
            return replace(last, t=sample.t, t_read=sample.t_read, status=last.status | Status.STALE)
        return sample

    def _measured(self, sample: Sample, drive: dict[str, PlannedFault]) -> Sample:
        """Return the sample as the drive measures it under the drive faults `drive`."""
        angle = sample.motor_position
        if "stuck-encoder" in drive:
            self._stuck = angle if math.isnan(self._stuck) else self._stuck
            angle = self._stuck
        if "jumping-encoder" in drive:
            angle += drive["jumping-encoder"].amount
        if "noisy-encoder" in drive:
            angle += drive["noisy-encoder"].amount * float(self._plan.random(self._number).standard_normal())
        if "over-temperature" in drive:
            sample = replace(sample, temperature=drive["over-temperature"].amount)
        return replace(sample, motor_position=angle)
