"""The fault contract: every drive over its emulator meets the same faults, and none of them ends with torque on.

A fault is a counted gap (NoReply, BadReply) or an error of its own kind with its remedy; a sample that is accepted is
never an old one. What only one protocol has stands in that drive's own test_faults.py.
"""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pytest

from drivers.cia402.profiles import RESTARTED as CIA402_RESTARTED
from drivers.commander.servo import RESTARTED as COMMANDER_RESTARTED
from drivers.commander.servo import STOPPED as COMMANDER_STOPPED
from drivers.dynamixel import faults as dynamixel
from drivers.dynamixel.models import POSITION_LSB
from drivers.feetech import faults as feetech
from drivers.mit.frames import RESTARTED as MIT_RESTARTED
from drivers.moteus.frames import RESTARTED as MOTEUS_RESTARTED
from drivers.moteus.frames import WATCHDOG as MOTEUS_WATCHDOG
from drivers.odrive.messages import RESTARTED as ODRIVE_RESTARTED
from drivers.robstride import frames as robstride_frames
from drivers.servo import BadReply, Command, DeviceFault, DriverError, Limits, LinkLost, NoReply, Quantity, Sample
from drivers.uart.port import POLL
from sim_backend.wire.canopen.node import HEARTBEAT_LOST
from sim_backend.wire.cia402 import device as cia402
from sim_backend.wire.commander.emulator import WATCHDOG as COMMANDER_WATCHDOG
from sim_backend.wire.commander.motion import MotionControl
from sim_backend.wire.dynamixel.device import OVERHEAT, OVERLOAD, VOLTAGE, DynamixelDevice
from sim_backend.wire.faults import (
    BusOff,
    CorruptReplies,
    DelayReplies,
    DropReplies,
    DropRequests,
    DuplicateReplies,
    NoiseBefore,
    Reboots,
    TruncateReplies,
    Unplug,
    WireFault,
)
from sim_backend.wire.feetech.device import HEAT, OVER_CURRENT, FeetechDevice
from sim_backend.wire.feetech.device import OVERLOAD as FEETECH_OVERLOAD
from sim_backend.wire.mit import device as mit
from sim_backend.wire.moteus import device as moteus
from sim_backend.wire.moteus.command import POSITION as MOTEUS_POSITION
from sim_backend.wire.odrive import device as odrive
from sim_backend.wire.odrive import states as odrive_states
from sim_backend.wire.odrive.endpoints import flat_endpoints
from sim_backend.wire.robstride import device as robstride

from .conftest import MX_LIMITS, marks_of, sampled

Rig = Any
Fresh = Callable[[Sample], bool]
TURN = 2.0 * np.pi


class Make(Protocol):
    def __call__(self, drive: Drive) -> Rig: ...


@dataclass(frozen=True)
class DeviceError:
    """An error that the device latches: how it comes about, the words it is reported with, and its code."""

    happen: Callable[[Rig], None]
    words: str
    code: int


@dataclass(frozen=True)
class Watch:
    """The device's own watchdog: s of silence after which the torque is still on, then off; then the error."""

    on: float
    off: float
    words: str
    code: int


@dataclass(frozen=True)
class Drive:
    """A drive behind its emulator, and what the contract must know of it. Fields that are None: it has no such thing.

    fixture, arguments: what makes its rig. push: of `quantity`, N m or rad. period s between ticks. fresh: makes a
    rule by which a sample shows that it is no older than its time. restarted: the code of a restart. off: whether the
    drive is disarmed.
    """

    fixture: str
    arguments: tuple[Any, ...]
    limits: Limits
    push: float
    fresh: Callable[[Rig, Any], Fresh]
    restarted: int
    left_on: Callable[[Rig], None]
    damages: tuple[WireFault, ...]
    lates: tuple[float, ...]
    random: tuple[Any, ...]
    links: tuple[WireFault, ...]
    boot: float = 0.6
    reboot: Callable[[Rig], None] = lambda rig: rig.device.reboot(rig.clock.now())
    deadline: float = 0.008 + 1e-4
    late_count: int = 1
    step: int = 1
    period: float = 2e-3
    ignore_off: Callable[[Rig], None] | None = None
    patient: tuple[tuple[str, Any], ...] = ()
    off: Callable[[Rig], bool] = lambda rig: not rig.motor.enabled
    quiet: Callable[[Rig], None] = lambda _: None
    silence: int = 1
    prepare: Callable[[Rig, Path], None] | None = None
    absent: tuple[int, str] | None = None
    twins: tuple[Callable[[Rig], Any], ...] | None = None
    twice: int | None = None
    latched: tuple[DeviceError, ...] | None = None
    running: DeviceError | None = None
    hot: DeviceError | None = None
    refused: tuple[Callable[[Rig], Any], str] | None = None
    watch: Watch | None = None
    ageless: int | None = None
    lost: tuple[int, ...] = (1, 2)
    quantity: Quantity = Quantity.TORQUE

    @property
    def command(self) -> Command:
        return Command(self.quantity, self.push)


# -- how a sample shows its age -------------------------------------------------------------------------------------


def of_registers(rig: Rig, _servo: Any) -> Fresh:
    return lambda sample: sample.motor_position == rig.device.registers.get("present_position") * POSITION_LSB


def of_one_turn(rig: Rig, _servo: Any) -> Fresh:
    return lambda sample: round(sample.motor_position / POSITION_LSB) % 4096 == rig.device.get("present_position")


def odrive_ages(rig: Rig, _servo: Any) -> Fresh:
    """Every estimate of the position is a number of its own, as for the drives below."""
    made: list[float] = []

    def numbered() -> bytes:
        made.append(rig.clock.now())
        return struct.pack("<ff", float(len(made)), 0.0)

    rig.device._message[0x09] = numbered
    return lambda sample: made[round(sample.motor_position / TURN) - 1] >= sample.t - 1e-3  # one that came unasked


def feetech_ages(rig: Rig, _servo: Any) -> Fresh:
    made: list[float] = []

    class Numbered(FeetechDevice):
        def _position(self) -> int:
            made.append(rig.clock.now())
            return len(made) - 1

    rig.device.__class__ = Numbered
    return lambda sample: made[round(sample.motor_position / POSITION_LSB)] >= sample.t


def mit_ages(rig: Rig, servo: Any) -> Fresh:
    made: list[float] = []
    state = rig.device._state

    def frame() -> Any:
        made.append(rig.clock.now())
        reply = state()
        return replace(reply, data=reply.data[:1] + (20_000 + len(made)).to_bytes(2, "big") + reply.data[3:])

    rig.device._state = frame
    return lambda s: made[round((s.motor_position + 12.5) / servo.info.position_lsb) - 20_001] >= s.t


def robstride_ages(rig: Rig, servo: Any) -> Fresh:
    made: list[float] = []
    feedback = rig.device._feedback

    def frame(kind: int = 2) -> Any:
        made.append(rig.clock.now())
        reply = feedback(kind)
        return replace(reply, data=(20_000 + len(made)).to_bytes(2, "big") + reply.data[2:])

    rig.device._feedback = frame
    return lambda s: made[round(s.motor_position / servo.info.position_lsb + 0x7FFF + 0.5) - 20_001] >= s.t


def moteus_ages(rig: Rig, _servo: Any) -> Fresh:
    made: list[float] = []

    class Numbered(moteus.MoteusDevice):
        @property
        def turns(self) -> float:
            made.append(rig.clock.now())
            return float(len(made) - 1)

    rig.device.__class__ = Numbered
    return lambda sample: made[round(sample.motor_position / TURN)] >= sample.t - 2.5e-3


def cia402_ages(rig: Rig, _servo: Any) -> Fresh:
    made: list[float] = []

    def value() -> int:
        made.append(rig.clock.now())
        return len(made)

    rig.device.objects.read_hooks[0x6064, 0] = value
    return lambda sample: made[int(sample.motor_position / (TURN / 4096) + 0.5) - 1] >= sample.t


def commander_ages(rig: Rig, _servo: Any) -> Fresh:
    made: list[float] = []

    class Numbered(MotionControl):
        def angle(self, _motor: Any) -> float:
            made.append(rig.clock.now())
            return float(len(made) - 1)

    rig.motor.law.__class__ = Numbered
    return lambda sample: made[round(sample.motor_position)] >= sample.t


# -- the drives -----------------------------------------------------------------------------------------------------


def fails(bits: int) -> Callable[[Rig], None]:
    return lambda rig: rig.device.fail(bits)


def warms_to(temperature: float) -> Callable[[Rig], None]:
    def warm(rig: Rig) -> None:
        rig.motor.warm_to(temperature)
        rig.wait(2e-3)

    return warm


def ignores_off(rig: Rig) -> None:
    rig.device.life.ignores_off = True


def another(make: Callable[[], Any], **different: Any) -> Callable[[Rig], Any]:
    def join(rig: Rig) -> None:
        device = make()
        for name, value in different.items():
            setattr(device, name, value)
        rig.bus.nodes.append(device)

    return join


def another_servo(model: str) -> Callable[[Rig], Any]:
    def join(rig: Rig) -> None:
        rig.bus.devices.append(DynamixelDevice(model))
        rig.bus.devices[1].registers.put("homing_offset", 1000)

    return join


def servo_left_on(rig: Rig) -> None:
    rig.device.write(64, b"\x01")


def another_feetech(model: str) -> Callable[[Rig], Any]:
    def join(rig: Rig) -> None:
        rig.bus.devices.append(FeetechDevice(model))
        rig.bus.devices[1]._centre = 1234

    return join


def refuses_above_10(address: int) -> Callable[[Rig], None]:
    def refuse(rig: Rig) -> None:
        items = rig.device.registers.items
        items[address] = replace(items[address], high=10)

    return refuse


def refuse_current_limit(rig: Rig) -> None:
    servo_left_on(rig)
    items = rig.device.registers.items
    items[38] = replace(items[38], high=10)


def with_endpoints(rig: Rig, path: Path) -> None:
    names = path / "endpoints.json"
    names.write_text(json.dumps(flat_endpoints("0.6.10")), encoding="utf-8")
    rig.config = replace(rig.config, endpoints=str(names))


def moteus_left_on(rig: Rig) -> None:
    rig.device.mode = MOTEUS_POSITION
    rig.motor.enable()


def cia402_left_on(rig: Rig) -> None:
    rig.armed(DRIVES["cia402 epos4"].limits)
    assert rig.motor.enabled


def board_left_on(rig: Rig) -> None:
    rig.motor.enable()
    rig.motor.law.target = 0.2
    for character in "M0.05":  # another program died while it was typing
        rig.bus.device.type(character)


def cut_short(*lengths: int) -> tuple[WireFault, ...]:
    return tuple(TruncateReplies(keep=keep) for keep in lengths)


def each(low: float, high: float, step: float) -> tuple[float, ...]:
    return tuple(float(late) for late in np.arange(low, high, step))


SHARED = (DelayReplies, DropReplies, DuplicateReplies, TruncateReplies, DropRequests)
GONE: tuple[WireFault, ...] = (BusOff(), Unplug())


def an_odrive(firmware: str, **changes: Any) -> Drive:
    layout = firmware[:3]
    drive = Drive(
        "make_odrive",
        (firmware,),
        Limits(torque=0.4, velocity=60.0, temperature=80.0, position=(-3.0, 3.0)),
        0.1,
        fresh=odrive_ages,
        restarted=ODRIVE_RESTARTED,
        left_on=lambda rig: rig.device._request_state(odrive_states.CLOSED_LOOP),
        ignore_off=ignores_off,
        damages=cut_short(0, 3, 7),
        lates=each(0.001, 0.026, 0.001),
        random=SHARED,
        links=GONE,
        deadline=0.008 + 1e-3,
        step=3,
        off=lambda rig: rig.device.state == odrive_states.IDLE and not rig.motor.enabled,
        quiet=lambda rig: rig.device._next.update(encoder=1e9),  # what it sends unasked would do as well
        absent=(5, r"no ODrive axis 5 answers.*heartbeat"),
        twins=(another(lambda: odrive.OdriveDevice(0, firmware=firmware), _offset=1.0),),
        twice=1,
        latched=(DeviceError(fails(odrive.DRIVER_FAULT[layout]), "failed", odrive.DRIVER_FAULT[layout]),),
        running=DeviceError(fails(odrive.OVERSPEED[layout]), "faster than its limit", odrive.OVERSPEED[layout]),
        hot=DeviceError(warms_to(121.0), "too hot", odrive.OVERHEAT[layout]),
        ageless=10,
        lost=(1, 2, 3),
    )
    return replace(drive, **changes)


def a_mit_motor(model: str, **changes: Any) -> Drive:
    damiao = model.startswith("dm")
    overcurrent = mit.OVER_CURRENT[damiao]
    drive = Drive(
        "make_mit",
        (model,),
        Limits(torque=2.0, velocity=20.0, temperature=85.0, position=(-3.0, 3.0)),
        1.0,
        fresh=mit_ages,
        restarted=MIT_RESTARTED,
        left_on=lambda rig: rig.motor.enable(),
        ignore_off=ignores_off,
        damages=cut_short(0, 3, 7),
        lates=each(0.001, 0.027, 0.001),
        random=(DelayReplies, DropReplies, TruncateReplies, DropRequests),
        links=GONE,
        absent=(9, r"no motor 9 answers.*mit\.reply_id"),
        twins=(another(lambda: mit.MitDevice(model), _zero=1.0),),
        twice=1,
        latched=(DeviceError(fails(overcurrent), "current was too high", overcurrent),),
        running=DeviceError(fails(overcurrent), "current was too high", overcurrent),
        hot=DeviceError(warms_to(121.0), "too hot", mit.TOO_HOT[damiao]),
        ageless=5,
    )
    return replace(drive, **changes)


def a_cia402_drive(model: str) -> Drive:
    overcurrent = DeviceError(fails(cia402.OVERCURRENT), "over-current: check the motor's wires", cia402.OVERCURRENT)
    following = DeviceError(fails(cia402.FOLLOWING_ERROR), r"0x8611: the following error", cia402.FOLLOWING_ERROR)
    return Drive(
        "make_cia402",
        (model,),
        Limits(torque=0.04, velocity=60.0, temperature=80.0, position=(-3.0, 3.0)),
        0.01,
        fresh=cia402_ages,
        restarted=CIA402_RESTARTED,
        left_on=cia402_left_on,
        ignore_off=lambda rig: setattr(rig.device.machine, "ignores_controlword", True),
        damages=cut_short(0, 3, 7),
        lates=each(0.001, 0.029, 0.002),
        random=SHARED,
        links=GONE,
        deadline=0.01 + 1e-3,
        step=7,
        absent=(5, r"no CANopen node 5 answers.*1000000 bit/s.*termination"),
        twins=(another(lambda: cia402.Cia402Device(model, 1, serial=0x62004412)),),
        twice=5,
        latched=(overcurrent,),
        running=following,
        # above the limit that was written, below the drive's own
        hot=DeviceError(warms_to(81.0), "too hot", cia402.OVERTEMPERATURE) if model == "epos4" else None,
        watch=Watch(0.07, 0.05, "received no heartbeat", HEARTBEAT_LOST),
        lost=(1, 2, 3),
    )


SERVO = Drive(
    "make_rig",
    (),
    Limits(torque=0.03, velocity=40.0, temperature=65.0, position=(-3.0, 3.0)),
    0.01,
    fresh=of_registers,
    restarted=dynamixel.RESTARTED,
    left_on=servo_left_on,
    ignore_off=ignores_off,
    damages=(CorruptReplies(), *cut_short(20, 37, 5)),
    lates=each(0.0075, 0.06, 0.0005),
    random=(*SHARED, CorruptReplies, NoiseBefore),
    links=(Unplug(),),
    deadline=0.008 + 69 * 10e-6 + 2 * POLL,
    absent=(9, "no servo 9 answers"),
    twins=(another_servo("xm430-w210"), another_servo("xl330-m288")),
    latched=(
        DeviceError(fails(OVERLOAD), "load", OVERLOAD),
        DeviceError(fails(VOLTAGE), "supply", VOLTAGE),
        DeviceError(fails(OVERHEAT), "hot", OVERHEAT),
        DeviceError(fails(0x40), "unknown error bits 0x40", 0x40),
    ),
    running=DeviceError(fails(OVERLOAD), "load", OVERLOAD),
    hot=DeviceError(warms_to(66.0), "hot", OVERHEAT),
    refused=(refuse_current_limit, "refused writing 83 to 38"),
    watch=Watch(0.09, 0.03, "received nothing", dynamixel.WATCHDOG),
)

FEETECH = Drive(
    "make_feetech",
    (),
    Limits(torque=0.4, velocity=40.0, temperature=65.0, position=(-20.0, 20.0)),
    0.03,
    fresh=feetech_ages,
    restarted=feetech.RESTARTED,
    left_on=lambda rig: rig.device.write(40, b"\x01"),
    ignore_off=ignores_off,
    damages=(CorruptReplies(), *cut_short(20, 10, 5)),
    lates=each(0.0075, 0.06, 0.0005),
    random=(*SHARED, CorruptReplies, NoiseBefore),
    links=(Unplug(),),
    deadline=0.008 + 45 * 10e-6 + 2 * POLL,
    absent=(9, "no servo 9 answers"),
    twins=(another_feetech("sts3215"), another_feetech("hls3930m")),
    latched=(
        DeviceError(fails(OVER_CURRENT), "current was too high", OVER_CURRENT),
        DeviceError(fails(FEETECH_OVERLOAD), "load", FEETECH_OVERLOAD),
        DeviceError(fails(0x40), "unknown error bits 0x40", 0x40),
    ),
    running=DeviceError(fails(OVER_CURRENT), "current was too high", OVER_CURRENT),
    hot=DeviceError(warms_to(66.0), "hot", HEAT),
    refused=(refuses_above_10(28), "keeps 1000 in protection_current where 50 was written"),
)

MOTEUS = Drive(
    "make_moteus",
    (),
    Limits(torque=0.4, velocity=60.0, temperature=70.0, position=(-3.0, 3.0)),
    0.1,
    fresh=moteus_ages,
    restarted=MOTEUS_RESTARTED,
    left_on=moteus_left_on,
    ignore_off=ignores_off,
    damages=cut_short(0, 2, 3, 13, 14, 20, 30),
    lates=(*each(0.001, 0.03, 0.001), 0.05, 0.08),
    late_count=3,
    random=SHARED,
    links=GONE,
    step=2,
    patient=(("watchdog", 1.0),),
    off=lambda rig: rig.device.mode == moteus.STOPPED and not rig.motor.enabled,
    absent=(9, r"no moteus 9 answers.*CAN FD"),
    twins=(another(lambda: moteus.MoteusDevice(serial=(1, 2, 3))),),
    twice=1,
    latched=(DeviceError(fails(moteus.DRIVER_FAULT), "motor driver failed", moteus.DRIVER_FAULT),),
    running=DeviceError(fails(moteus.DRIVER_FAULT), "motor driver failed", moteus.DRIVER_FAULT),
    hot=DeviceError(warms_to(71.0), "too hot", moteus.OVER_TEMPERATURE),
    refused=(
        lambda rig: rig.device.console.refused.add("servo.timeout_mode"),
        r"keeps 12 in servo\.timeout_mode where 0 was written",
    ),
    watch=Watch(0.095, 0.01, "received nothing", MOTEUS_WATCHDOG),
)

ROBSTRIDE = Drive(
    "make_robstride",
    (),
    Limits(torque=2.0, velocity=20.0, temperature=85.0, position=(-3.0, 3.0)),
    1.0,
    fresh=robstride_ages,
    restarted=robstride_frames.RESTARTED,
    left_on=lambda rig: rig.motor.enable(),
    ignore_off=ignores_off,
    damages=cut_short(0, 3, 7),
    lates=each(0.001, 0.027, 0.001),
    random=(DelayReplies, DropReplies, TruncateReplies, DropRequests),
    links=GONE,
    absent=(9, r"no motor 9 answers.*1000000 bit/s.*termination"),
    twins=(another(lambda: robstride.RobstrideDevice(serial=7)), another(robstride.RobstrideDevice, _zero=1.0)),
    twice=3,
    latched=tuple(
        DeviceError(fails(bit), words, robstride_frames.REPORTED | bit)
        for bit, words in ((robstride.STALL, "too high for too long"), (robstride.OVERVOLTAGE, "voltage is too high"))
    ),
    running=DeviceError(fails(robstride.DRIVER), "driver chip", robstride_frames.REPORTED | robstride.DRIVER),
    hot=DeviceError(warms_to(146.0), "too hot", robstride_frames.REPORTED | robstride.OVERHEAT),
    refused=(lambda rig: rig.device.refused.add("canTimeout"), "keeps 0 in canTimeout where 2000 was written"),
    watch=Watch(0.095, 0.01, "received nothing", robstride_frames.WATCHDOG),
    ageless=5,
)

BOARD = Drive(
    "make_foc",
    (),
    Limits(torque=4e-3, velocity=400.0, temperature=80.0, position=(-3.0, 3.0)),
    2e-3,
    fresh=commander_ages,
    restarted=COMMANDER_RESTARTED,
    left_on=board_left_on,
    ignore_off=lambda rig: rig.faults.inject(DropReplies(count=18)),  # it is done and never confirmed
    damages=(CorruptReplies(count=3), *(TruncateReplies(count=3, keep=keep) for keep in (0, 9))),
    lates=each(0.004, 0.04, 0.004),
    late_count=3,
    random=(DelayReplies, DropReplies, DuplicateReplies, DropRequests, NoiseBefore),
    links=(Unplug(),),
    deadline=0.008 + 0.006,
    step=1,
    period=4e-3,
    silence=1000,
    boot=4.0,
    reboot=lambda rig: rig.bus.reboot(rig.clock.now()),
    off=lambda rig: not rig.motor.enabled and rig.motor.law.target == 0.0,
    refused=(lambda rig: rig.bus.garble("MLC0", "MLC9"), "current limit"),
)

DRIVES = {
    "dynamixel": SERVO,
    "dynamixel mx": replace(
        SERVO,
        arguments=("mx-64",),
        limits=MX_LIMITS,
        push=0.05,
        fresh=of_one_turn,
        damages=(CorruptReplies(), *cut_short(10, 5)),
        off=lambda rig: (
            (rig.motor.enabled, rig.device.get("goal_torque"), rig.device.get("torque_control")) == (0, 0, 0)
        ),
        twins=None,
        latched=None,
        running=None,
        hot=None,
        refused=None,
        watch=None,
    ),
    "feetech hls": FEETECH,
    "feetech sts": replace(
        FEETECH,
        arguments=("sts3215",),
        push=0.5,
        quantity=Quantity.POSITION,
        refused=(refuses_above_10(48), "keeps 1000 in torque_limit where 136 was written"),
    ),
    "odrive 0.5.6": an_odrive("0.5.6", twice=None),
    "odrive 0.6.10": an_odrive("0.6.10"),
    "odrive with endpoints": an_odrive(
        "0.6.10",
        prepare=with_endpoints,
        ignore_off=None,  # the watchdog ends it
        watch=Watch(0.095, 0.01, "received nothing", odrive.WATCHDOG["0.6"]),
    ),
    # an AK does not say whether it is on, and answered with 6 bytes before it could tell its temperature
    "mit ak80-9": a_mit_motor("ak80-9", ignore_off=None, damages=cut_short(0, 3, 5)),
    "mit dm-j4310": a_mit_motor(
        "dm-j4310",
        refused=(lambda rig: rig.device.refused.add(9), "keeps 0 in timeout where 2000 was written"),
        watch=Watch(0.095, 0.01, "received nothing", mit.LOST_COMMUNICATION),
    ),
    "robstride": ROBSTRIDE,
    "moteus": MOTEUS,
    **{f"cia402 {model}": a_cia402_drive(model) for model in ("epos4", "epos2", "generic")},
    "commander": BOARD,
    "commander with a watchdog": replace(
        BOARD,
        prepare=lambda rig, _: setattr(rig.bus, "watchdog", COMMANDER_WATCHDOG),
        watch=Watch(0.9 * COMMANDER_WATCHDOG, 0.2 * COMMANDER_WATCHDOG, "by itself", COMMANDER_STOPPED),
    ),
}


def every(*fields: str) -> pytest.MarkDecorator:
    """Every drive that has what the test is about."""
    having = [key for key, drive in DRIVES.items() if all(getattr(drive, field) is not None for field in fields)]
    return pytest.mark.parametrize("drive", [pytest.param(DRIVES[key], id=key, marks=marks_of(key)) for key in having])


@pytest.fixture
def make(request: pytest.FixtureRequest, tmp_path: Path) -> Make:
    def rig(drive: Drive) -> Rig:
        made = request.getfixturevalue(drive.fixture)(*drive.arguments)
        if drive.prepare is not None:
            drive.prepare(made, tmp_path)
        return made

    return rig


def tick(rig: Rig, drive: Drive, servo: Any) -> Sample:
    rig.wait(drive.period)
    sample: Sample = servo.exchange(drive.command)
    return sample


def armed(make: Make, drive: Drive, **changes: Any) -> tuple[Rig, Any]:
    rig = make(drive)
    servo = rig.armed(drive.limits, **changes)
    tick(rig, drive, servo)
    return rig, servo


def samples(rig: Rig, drive: Drive, servo: Any, ticks: int) -> Iterator[Sample]:
    """What comes of driving on as a recorder does, through every gap."""
    for _ in range(ticks):
        with contextlib.suppress(NoReply, BadReply):
            yield tick(rig, drive, servo)


def ends_with(rig: Rig, drive: Drive, servo: Any, words: str, code: int) -> None:
    """Drive on until the device's fault is reported."""
    with pytest.raises(DeviceFault, match=words) as caught:
        list(samples(rig, drive, servo, 1000))
    assert caught.value.code == code


def residue(rig: Rig, servo: Any) -> float:
    """The magnitude of the torque in counts, in uN m where the drive does not tell its count."""
    lsb = servo.info.torque_lsb
    return float(abs(rig.motor.torque) / (lsb if lsb > 0.0 else 1e-6))


# -- opening --------------------------------------------------------------------------------------------------------


@every("absent")
def test_an_id_at_which_nobody_answers_is_no_reply_that_says_what_to_check(make: Make, drive: Drive) -> None:
    assert drive.absent is not None
    ident, words = drive.absent
    rig = make(drive)
    with pytest.raises(NoReply, match=words):
        rig.open(id=ident)
    assert rig.closed


@every("twins")
def test_two_drives_with_one_id_are_refused(make: Make, drive: Drive) -> None:
    for join in drive.twins or ():
        rig = make(drive)
        join(rig)
        with pytest.raises((NoReply, BadReply), match=r"two \w+ with that (node )?id"):
            rig.open()
        assert not rig.motor.enabled


@every("twice")
def test_an_answer_that_comes_twice_is_taken_for_two_drives(make: Make, drive: Drive) -> None:
    rig = make(drive)
    rig.faults.inject(DuplicateReplies(count=drive.twice or 0))
    with pytest.raises(BadReply, match="answers twice"):
        rig.open()


@every()
def test_a_drive_that_another_program_left_on_is_off_once_it_is_opened(make: Make, drive: Drive) -> None:
    rig = make(drive)
    drive.left_on(rig)
    rig.open()
    assert drive.off(rig)


# -- arming ---------------------------------------------------------------------------------------------------------


@every("latched")
def test_a_latched_error_keeps_it_from_arming(make: Make, drive: Drive) -> None:
    for error in drive.latched or ():
        rig = make(drive)
        servo = rig.open()
        error.happen(rig)
        with pytest.raises(DeviceFault, match=error.words) as caught:
            servo.arm(drive.limits)
        assert caught.value.code == error.code
        assert not rig.motor.enabled
        servo.close()


@every("refused")
def test_a_limit_that_the_device_refuses_stops_the_arming_with_the_torque_off(make: Make, drive: Drive) -> None:
    assert drive.refused is not None
    refuse, words = drive.refused
    rig = make(drive)
    servo = rig.open()
    refuse(rig)
    with pytest.raises(DriverError, match=words):
        servo.arm(drive.limits)
    assert drive.off(rig)


@sampled(8)
@every()
def test_a_message_lost_at_any_point_of_the_arming_leaves_no_torque(make: Make, drive: Drive, nth: int) -> None:
    rig = make(drive)
    rig.open().arm(drive.limits)
    for place in range(0, rig.faults.replies, nth * drive.step):
        for fault in (DropReplies(after=place), DropRequests(after=place)):
            rig = make(drive)
            rig.faults.inject(fault)
            try:
                servo = rig.armed(drive.limits)
            except DriverError:
                assert drive.off(rig)
            else:
                assert residue(rig, servo) <= 0.51
                assert list(samples(rig, drive, servo, 5))
                servo.close()
                assert drive.off(rig)


# -- running --------------------------------------------------------------------------------------------------------


@every()
def test_silence_is_no_reply_within_its_deadline_and_costs_one_sample(make: Make, drive: Drive) -> None:
    rig, servo = armed(make, drive)
    drive.quiet(rig)
    rig.wait(drive.period)
    rig.faults.inject(DropReplies(count=drive.silence))
    begin = rig.clock.now()
    with pytest.raises(NoReply):
        servo.exchange(drive.command)
    assert rig.clock.now() - begin <= drive.deadline
    rig.faults.clear()
    assert servo.exchange(drive.command).motor_torque > 0.0


@every()
def test_a_damaged_reply_is_a_gap_and_the_next_one_is_good(make: Make, drive: Drive) -> None:
    for damage in drive.damages:
        rig, servo = armed(make, drive)
        fresh = drive.fresh(rig, servo)
        rig.faults.inject(damage)
        with pytest.raises((BadReply, NoReply)):
            servo.exchange(drive.command)
        sample = servo.exchange(drive.command)
        assert fresh(sample)
        assert sample.motor_torque > 0.0


@sampled(10)
@every()
def test_a_late_reply_is_never_taken_for_the_answer_to_the_next_request(make: Make, drive: Drive, nth: int) -> None:
    for late in drive.lates[::nth]:
        rig, servo = armed(make, drive, **dict(drive.patient))
        fresh = drive.fresh(rig, servo)
        rig.faults.inject(DelayReplies(seconds=late, count=drive.late_count))
        accepted = [fresh(sample) for sample in samples(rig, drive, servo, 20)]
        assert len(accepted) >= 5
        assert all(accepted)
        servo.close()
        assert drive.off(rig)


@every("ageless")
@pytest.mark.parametrize("late", [0.03, 0.045, 0.06])
def test_replies_that_carry_no_age_and_come_very_late_are_noticed_after_few_samples(
    make: Make, drive: Drive, late: float
) -> None:
    rig, servo = armed(make, drive, watchdog=1.0)
    fresh = drive.fresh(rig, servo)
    rig.faults.inject(DelayReplies(seconds=late, count=drive.ageless or 0))
    old, said = 0, ""
    for _ in range(40):
        try:
            old += not fresh(tick(rig, drive, servo))
        except (NoReply, BadReply) as error:
            said += str(error)
    assert old <= 3
    assert "a late reply" in said
    tick(rig, drive, servo)
    servo.disarm()
    assert drive.off(rig)


@every("ageless")
def test_a_second_drive_that_joins_the_bus_in_the_run_is_noticed(make: Make, drive: Drive) -> None:
    rig, servo = armed(make, drive)
    rig.faults.inject(DuplicateReplies(count=50))
    tick(rig, drive, servo)
    with pytest.raises(BadReply, match="a second drive with the same id"):
        tick(rig, drive, servo)


@sampled(5)
@every()
def test_whatever_happens_to_the_messages_no_sample_is_old_and_torque_off_works(
    make: Make, drive: Drive, nth: int
) -> None:
    rng = np.random.default_rng(3)
    rounds, ticks, accepted = 10 // nth, 60, 0
    for _ in range(rounds):
        rig, servo = armed(make, drive, **dict(drive.patient))
        fresh = drive.fresh(rig, servo)
        for kind in rng.choice(np.array(drive.random), size=4):
            rig.faults.inject(kind(after=int(rng.integers(60)), count=int(rng.integers(1, 4))))
        for sample in samples(rig, drive, servo, ticks):
            accepted += 1
            assert fresh(sample)
        rig.faults.clear()
        servo.disarm()
        assert drive.off(rig)
    assert accepted > 2 / 3 * rounds * ticks


@every("running")
def test_an_error_in_the_run_is_a_fault_with_its_code_and_the_torque_is_off(make: Make, drive: Drive) -> None:
    assert drive.running is not None
    rig, servo = armed(make, drive)
    drive.running.happen(rig)
    ends_with(rig, drive, servo, drive.running.words, drive.running.code)
    assert not rig.motor.enabled
    servo.disarm()
    servo.close()
    assert not rig.motor.enabled


@every("hot")
def test_overheating_turns_the_torque_off_and_is_reported(make: Make, drive: Drive) -> None:
    assert drive.hot is not None
    rig, servo = armed(make, drive)
    drive.hot.happen(rig)
    assert not rig.motor.enabled
    assert rig.motor.torque == 0.0
    ends_with(rig, drive, servo, drive.hot.words, drive.hot.code)
    servo.disarm()


@every()
def test_a_drive_that_restarts_in_the_run_is_a_fault_and_can_be_armed_again(make: Make, drive: Drive) -> None:
    for after in (0, 1, 2):
        rig, servo = armed(make, drive)
        rig.faults.inject(Reboots(after=after))
        ends_with(rig, drive, servo, "restarted", drive.restarted)
        servo.disarm()
        assert drive.off(rig)
        servo.arm(drive.limits)
        assert list(samples(rig, drive, servo, 5))[-1].motor_torque > 0.0
        servo.close()
        assert drive.off(rig)


@every()
def test_a_restart_that_is_over_before_the_next_request_is_noticed(make: Make, drive: Drive) -> None:
    rig, servo = armed(make, drive)
    drive.reboot(rig)
    rig.wait(drive.boot)
    ends_with(rig, drive, servo, "restarted", drive.restarted)
    servo.disarm()
    assert drive.off(rig)


@every()
def test_a_link_that_is_gone_ends_the_run_and_closing_twice_is_harmless(make: Make, drive: Drive) -> None:
    for gone in drive.links:
        rig, servo = armed(make, drive)
        rig.faults.inject(gone)
        with pytest.raises(LinkLost, match="cut the"):
            list(samples(rig, drive, servo, 3))
        with pytest.raises(DriverError, match=r"cut the \w+'s power|not confirmed"):
            servo.disarm()
        servo.close()
        servo.close()
        rig.wait(0.2)
        assert drive.watch is None or abs(rig.motor.torque) < 1e-6


# -- stopping -------------------------------------------------------------------------------------------------------


@every("watch")
def test_when_the_client_vanishes_the_watchdog_takes_the_torque_away(make: Make, drive: Drive) -> None:
    watch = drive.watch
    assert watch is not None
    rig, servo = armed(make, drive)
    rig.wait(watch.on)
    assert rig.motor.torque > 0.0
    rig.wait(watch.off)
    assert abs(rig.motor.torque) < 1e-6
    rig.wait(0.5)
    assert abs(rig.motor.torque) < 1e-6  # nor does it hold the position
    ends_with(rig, drive, servo, watch.words, watch.code)
    servo.disarm()
    assert drive.off(rig)
    servo.arm(drive.limits)  # what it stopped for is over
    assert list(samples(rig, drive, servo, 5))[-1].motor_torque > 0.0
    servo.close()
    assert drive.off(rig)


@every("ignore_off")
def test_a_torque_off_that_is_not_done_or_not_confirmed_is_an_error_that_says_to_cut_the_power(
    make: Make, drive: Drive
) -> None:
    rig, servo = armed(make, drive)
    assert drive.ignore_off is not None
    drive.ignore_off(rig)
    with pytest.raises(DriverError, match=r"cut the \w+'s power|not confirmed"):
        servo.disarm()
    rig.wait(0.02)  # less than any watchdog: zero torque was commanded as well
    assert residue(rig, servo) <= 0.51
    servo.close()


@every()
def test_torque_off_gets_through_though_messages_are_lost(make: Make, drive: Drive) -> None:
    for lost in drive.lost:
        for fault in (DropRequests(count=lost), DropReplies(count=lost)):
            rig, servo = armed(make, drive)
            rig.faults.inject(fault)
            servo.disarm()
            assert drive.off(rig)
