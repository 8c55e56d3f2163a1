"""Servos for the tests of the drivers: a DYNAMIXEL over its emulator, without I/O in virtual time and on a pty."""

from __future__ import annotations

import importlib.util
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from drivers.canbus.off_path import from_slcan_text
from drivers.cia402.config import Cia402Config
from drivers.cia402.servo import Cia402Servo
from drivers.clock import VirtualClock
from drivers.commander.config import CommanderConfig
from drivers.commander.servo import CommanderServo
from drivers.dynamixel.config import DynamixelConfig
from drivers.dynamixel.servo import DynamixelServo
from drivers.feetech.config import FeetechConfig
from drivers.feetech.servo import FeetechServo
from drivers.loadcell.config import LoadCellConfig
from drivers.loadcell.sensor import LoadCell
from drivers.mit.config import MitConfig
from drivers.mit.servo import MitServo
from drivers.moteus.config import MoteusConfig
from drivers.moteus.servo import MoteusServo
from drivers.odrive.config import OdriveConfig
from drivers.odrive.servo import OdriveServo
from drivers.packets.port import SerialPort
from drivers.robstride.config import RobstrideConfig
from drivers.robstride.servo import RobstrideServo
from drivers.servo import Command, Limits, Quantity, Sample, Servo
from hil.doctor.stop_path import answered
from hil.stand.file import load
from hil.stand.opening import open_servo
from hil.stand.servo import StandServo
from hil.stand.transmission import Transmission
from sim_backend.parameters import CouplingParameters, SimParameters
from sim_backend.servo import SimServo
from sim_backend.wire.canbus.bus import CanBus, CanNode, CanTiming
from sim_backend.wire.cia402.device import Cia402Device
from sim_backend.wire.commander.emulator import CommanderTiming, new_board
from sim_backend.wire.default_joint import scaled_joint
from sim_backend.wire.dynamixel.device import DynamixelDevice
from sim_backend.wire.dynamixel.emulator import serve
from sim_backend.wire.dynamixel.mx_device import MxDevice
from sim_backend.wire.dynamixel.tables import MX_MODELS
from sim_backend.wire.faults import WireFaults
from sim_backend.wire.feetech.device import FeetechDevice
from sim_backend.wire.loadcell.emulator import SCALE, EmulatedLoadCell, LoadCellBoard
from sim_backend.wire.mit.device import MitDevice
from sim_backend.wire.moteus.device import MoteusDevice
from sim_backend.wire.odrive.device import OdriveDevice
from sim_backend.wire.packets.bus import PacketBus, PacketTiming
from sim_backend.wire.robstride.device import RobstrideDevice
from sim_backend.wire.uart.pty_line import PtyLine

from ..loopback import CanLoopback, SerialLoopback

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
STAND = """
[stand]
backend = "dynamixel"
motor_inertia = 3.2e-6
motor_damping = 1.6e-6
[limits]
torque = 0.03
deflection = 1.5
velocity = 60.0
temperature = 65.0
[dynamixel]
port = "{port}"
model = "xl330-m288"
reply_timeout = 0.3
watchdog = 1.0
"""


@pytest.fixture(autouse=True)
def nothing_is_left_behind() -> Iterator[None]:
    yield
    assert not multiprocessing.active_children()


class Loopback(SerialPort):
    """The line to an emulated bus in virtual time: a wait for bytes is what makes time pass."""

    def __init__(self, bus: PacketBus, clock: VirtualClock, baudrate: int = 1_000_000) -> None:
        super().__init__("loopback", baudrate, clock)
        self.bus = bus
        self.sent = bytearray()
        self.closed = True
        self._virtual = clock

    def openPort(self) -> bool:  # noqa: N802 - the SDK's name
        port: Any = SerialLoopback(self.bus, self._virtual, self.baudrate)
        port.sent, self.ser = self.sent, port
        self.closed = False
        return True

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        self.closed = True
        super().closePort()

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        self.ser.reset_input_buffer()


@dataclass
class Rig:
    """An emulated bus or board, and what is needed to open a drive on it, in virtual time. plug: makes a new port
    where the last one was closed.
    """

    bus: Any
    clock: VirtualClock
    adapter: Callable[..., Any]
    config: Any
    port: Any
    plug: Callable[[], Any] | None = None

    def open(self, **changes: Any) -> Any:
        config = replace(self.config, **changes)
        self.port = self.plug() if self.plug and self.port.closed else self.port
        if isinstance(self.port, Loopback):
            self.port.baudrate = config.baudrate
        end = {"bus": self.port} if isinstance(self.port, CanLoopback) else {"port": self.port}
        return self.adapter(config, clock=self.clock, **end)

    def armed(self, limits: Limits, **changes: Any) -> Any:
        servo = self.open(**changes)
        servo.arm(limits)
        return servo

    @property
    def device(self) -> Any:
        drives = getattr(self.bus, "devices", None) or getattr(self.bus, "nodes", None) or [self.bus]
        return drives[0]

    @property
    def motor(self) -> Any:
        return self.device.motor

    @property
    def faults(self) -> WireFaults[Any]:
        faults: WireFaults[Any] = self.bus.faults
        return faults

    @property
    def closed(self) -> bool:
        return bool(self.port.closed)

    def wait(self, seconds: float) -> None:
        self.clock.sleep_until(self.clock.now() + seconds)
        if isinstance(self.port, CanLoopback):
            self.port.advance()
        else:
            self.bus.advance(self.clock.now())


def torque(value: float) -> Command:
    return Command(Quantity.TORQUE, value)


def position(value: float) -> Command:
    return Command(Quantity.POSITION, value)


def drive(rig: Rig, servo: Any, command: Command, ticks: int = 20) -> Sample:
    for _ in range(ticks):
        rig.wait(2e-3)
        sample: Sample = servo.exchange(command)
    return sample


def small_joint(coupling: CouplingParameters | None = None) -> SimParameters:
    """The paper's joint without a gear, which small torques move; a servo's own winding replaces this one."""
    joint = scaled_joint(1.0, 1.0, 1.0)
    return replace(joint, coupling=coupling or joint.coupling)


def new_rig(model: str = "xl330-m288", *, baudrate: int = 1_000_000, **device: Any) -> Rig:
    clock = VirtualClock()
    bus: PacketBus
    device = {"parameters": small_joint()} | device
    if model in MX_MODELS:
        bus = PacketBus([MxDevice(model, baudrate=baudrate, **device)], timing=PacketTiming(), protocol=1)
    else:
        bus = PacketBus([DynamixelDevice(model, baudrate=baudrate, **device)], timing=PacketTiming())
    watchdog = 0.0 if model in MX_MODELS else 0.1
    config = DynamixelConfig(port="loopback", model=model, baudrate=baudrate, watchdog=watchdog)  # type: ignore[arg-type]  # a Literal
    return Rig(bus, clock, DynamixelServo, config, Loopback(bus, clock, baudrate))


def feetech_rig(model: str = "hls3930m", *, baudrate: int = 1_000_000, **device: Any) -> Rig:
    clock = VirtualClock()
    device = {"parameters": small_joint()} | device
    bus = PacketBus([FeetechDevice(model, baudrate=baudrate, **device)], timing=PacketTiming(), protocol=1)
    constant = {"sts": 1.09, "hls3606m": 0.5}.get(model if model == "hls3606m" else model[:3])
    config = FeetechConfig("loopback", model, baudrate=baudrate, torque_constant=constant)  # type: ignore[arg-type]  # a Literal
    return Rig(bus, clock, FeetechServo, config, Loopback(bus, clock, baudrate))


def can_rig(adapter: Callable[..., Servo], config: Any, nodes: list[CanNode], bitrate: float = 1e6) -> Rig:
    clock = VirtualClock()
    bus = CanBus(nodes, timing=CanTiming(bitrate=bitrate))
    return Rig(bus, clock, adapter, config, CanLoopback(bus, clock), lambda: CanLoopback(bus, clock))


def odrive_rig(firmware: str = "0.6.10", **device: Any) -> Rig:
    config = OdriveConfig(interface="loopback", channel="", torque_constant=0.04, bitrate=1_000_000)
    return can_rig(OdriveServo, config, [OdriveDevice(firmware=firmware, **device)])


def mit_rig(model: str = "dm-j4310", **device: Any) -> Rig:
    config = MitConfig(interface="loopback", channel="", model=model)
    return can_rig(MitServo, config, [MitDevice(model, **device)])


def robstride_rig(model: str = "rs00", **device: Any) -> Rig:
    watchdog = 0.0 if model == "cybergear" else 0.1  # it has none
    config = RobstrideConfig(interface="loopback", channel="", model=model, watchdog=watchdog)
    return can_rig(RobstrideServo, config, [RobstrideDevice(model, **device)])


def moteus_rig(**device: Any) -> Rig:
    return can_rig(MoteusServo, MoteusConfig(interface="loopback", channel=""), [MoteusDevice(**device)])


def cia402_rig(model: str = "epos4", **device: Any) -> Rig:
    constant = 0.02 if model == "epos2" else None
    config = Cia402Config(interface="loopback", channel="", profile=model, torque_constant=constant)  # type: ignore[arg-type]  # a Literal
    return can_rig(Cia402Servo, config, [Cia402Device(model, **device)])


@pytest.fixture
def rig() -> Rig:
    return new_rig()


@pytest.fixture
def limits() -> Limits:
    return SERVO_LIMITS


def new_foc(baudrate: int = 1_000_000, **board: Any) -> Rig:
    clock = VirtualClock()
    made = new_board(baudrate=baudrate, timing=CommanderTiming(), **board)
    config = CommanderConfig("loopback", torque_constant=0.0145, watchdog=0.0, baudrate=baudrate)
    return Rig(
        made,
        clock,
        CommanderServo,
        config,
        SerialLoopback(made, clock, baudrate),
        lambda: SerialLoopback(made, clock, baudrate),
    )


def with_loadcell(rig: Rig) -> Servo:
    port = SerialLoopback(EmulatedLoadCell(LoadCellBoard(), rig.bus), rig.clock, 115200)
    return StandServo(rig.open(), 0.1, LoadCell(LoadCellConfig("loopback", SCALE), clock=rig.clock, port=port))


def maker(name: str, make: Callable[..., Rig]) -> Any:
    """A fixture that makes rigs."""
    return pytest.fixture(name=name)(lambda: make)


make_rig, make_feetech = maker("make_rig", new_rig), maker("make_feetech", feetech_rig)
make_odrive, make_mit = maker("make_odrive", odrive_rig), maker("make_mit", mit_rig)
make_robstride = maker("make_robstride", robstride_rig)
make_moteus, make_cia402 = maker("make_moteus", moteus_rig), maker("make_cia402", cia402_rig)
make_foc = maker("make_foc", new_foc)


SERVO_LIMITS = Limits(torque=0.03, velocity=40.0, temperature=65.0, position=(-3.0, 3.0))
MX_LIMITS = Limits(torque=0.06, velocity=40.0, temperature=65.0, position=(-8.0, 8.0))
FEETECH_LIMITS = Limits(torque=0.4, velocity=40.0, temperature=65.0, position=(-20.0, 20.0))
STS_LIMITS = replace(FEETECH_LIMITS, position=(-2.0, 2.0))
SCS_LIMITS = replace(FEETECH_LIMITS, torque=0.1, position=(1.6, 3.6))  # it begins at 2.6
ODRIVE_LIMITS = Limits(torque=0.4, velocity=60.0, temperature=80.0, position=(-3.0, 3.0))
CIA402_LIMITS = Limits(torque=0.04, velocity=60.0, temperature=80.0, position=(-3.0, 3.0))
MIT_LIMITS = Limits(torque=2.0, velocity=30.0, temperature=85.0, position=(-3.0, 3.0))
SIM_LIMITS = Limits(torque=4e-3, velocity=400.0, temperature=80.0, position=(-3.0, 3.0))


def closed_after(servo: Servo, limits: Limits) -> Iterator[tuple[Servo, Limits]]:
    try:
        yield servo, limits
    finally:
        servo.close()


def on_a_pty(path: Path) -> Iterator[tuple[Servo, Limits]]:
    with serve(path / "ttyDXL", "xl330-m288", timing=PacketTiming()) as line:
        servo = DynamixelServo(
            DynamixelConfig(port=str(line.link), model="xl330-m288", reply_timeout=0.3, watchdog=1.0)
        )
        yield from closed_after(servo, SERVO_LIMITS)


def on_a_stand(path: Path) -> Iterator[tuple[Servo, Limits]]:
    """The stand of a file, within its own limits."""
    stand = load(path)
    servo, _ = open_servo(stand)
    try:
        zero = answered(servo).motor_position
    except BaseException:
        servo.close()
        raise
    yield from closed_after(servo, Transmission.of(stand.stand).motor_limits(stand.checked_limits(), zero))


def foc_on_a_pty(path: Path) -> Iterator[tuple[Servo, Limits]]:
    with PtyLine(path / "ttyFOC", new_board(timing=CommanderTiming(), now=time.monotonic())) as line:
        config = CommanderConfig(str(line.link), torque_constant=0.0145, watchdog=0.0, reply_timeout=0.3)
        yield from closed_after(CommanderServo(config), SIM_LIMITS)


@dataclass
class Wired:
    """A servo in virtual time, and what an observer of its wire sees.

    sent: bytes or frames that have left so far. live: whether current can flow. reopen: open the device anew.
    device: the emulated drive. put: sends a packet of an `OffPath`, as another process on the same link does. wait:
    lets s pass.
    """

    servo: Servo
    limits: Limits
    sent: Callable[[], int]
    live: Callable[[], bool]
    unplug: Callable[[bool], None]
    reopen: Callable[[], Servo]
    device: Any
    put: Callable[[bytes], object]
    wait: Callable[[float], None]


def wired_rig(rig: Rig, limits: Limits, open_: Callable[[Rig], Servo] = Rig.open) -> Wired:
    def unplug(gone: bool) -> None:
        rig.bus.unplugged = gone

    def put(packet: bytes) -> None:
        if isinstance(rig.port, CanLoopback):
            rig.port.send(from_slcan_text(packet))
        else:
            (rig.port.writePort if isinstance(rig.port, Loopback) else rig.port.write)(packet)

    return Wired(
        open_(rig),
        limits,
        lambda: len(rig.port.sent),
        lambda: bool(rig.motor.enabled),
        unplug,
        reopen=lambda: open_(rig),
        device=rig.device,
        put=put,
        wait=rig.wait,
    )


def in_position(rig: Rig) -> Servo:
    mode = "extended-position" if isinstance(rig.config, DynamixelConfig) else "position"
    servo: Servo = rig.open(mode=mode)
    return servo


RIGS: dict[str, tuple[Callable[[], Rig], Limits]] = {
    "dynamixel": (new_rig, SERVO_LIMITS),
    "dynamixel mx": (lambda: new_rig("mx-64"), MX_LIMITS),
    "feetech hls": (feetech_rig, FEETECH_LIMITS),
    "odrive 0.5.6": (lambda: odrive_rig("0.5.6"), ODRIVE_LIMITS),
    "odrive 0.6.10": (odrive_rig, ODRIVE_LIMITS),
    "mit ak80-9": (lambda: mit_rig("ak80-9"), MIT_LIMITS),
    "mit dm-j4310": (mit_rig, MIT_LIMITS),
    "robstride": (robstride_rig, MIT_LIMITS),
    "moteus": (moteus_rig, ODRIVE_LIMITS),
    "cia402 epos4": (cia402_rig, CIA402_LIMITS),
    "cia402 epos2": (lambda: cia402_rig("epos2"), CIA402_LIMITS),
    "cia402 generic": (lambda: cia402_rig("generic"), CIA402_LIMITS),
    "commander": (new_foc, SIM_LIMITS),
}


def wired_drive(name: str) -> Wired:
    make, limits = RIGS[name]
    return wired_rig(make(), limits)


IN_VIRTUAL_TIME: dict[str, Callable[[], Wired]] = {
    **{name: partial(wired_drive, name) for name in RIGS},
    "feetech sts in position": lambda: wired_rig(feetech_rig("sts3215"), STS_LIMITS, in_position),
    "feetech scs in position": lambda: wired_rig(feetech_rig("scs0009"), SCS_LIMITS, in_position),
    "dynamixel in position": lambda: wired_rig(new_rig(), SERVO_LIMITS, in_position),
    "commander with a loadcell": lambda: wired_rig(new_foc(), SIM_LIMITS, with_loadcell),
}


def simulated(_: Path) -> Iterator[tuple[Servo, Limits]]:
    yield from closed_after(SimServo(SimParameters(), seed=1, clock=VirtualClock()), SIM_LIMITS)


IN_REAL_TIME = {"dynamixel on a pty": on_a_pty, "commander on a pty": foc_on_a_pty}
OTHERS = {"sim": simulated, **IN_REAL_TIME}
VARIANTS = {
    "dynamixel in position",
    "commander with a loadcell",
    "feetech sts",
    "feetech sts in position",
    "odrive 0.5.6",
    "odrive with endpoints",
    "mit ak80-9",
    "cia402 epos2",
    "cia402 generic",
}
"""Drives of which a sibling stands for them before each commit."""


def marks_of(name: str) -> tuple[pytest.MarkDecorator, ...]:
    """Return how a servo of this name is marked."""
    return (pytest.mark.study,) if name in VARIANTS or name in IN_REAL_TIME else ()


def benchmark(name: str) -> Any:
    """Return the module of a script in benchmarks/."""
    spec = importlib.util.spec_from_file_location(f"benchmark_{name}", BENCHMARKS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look for it
    spec.loader.exec_module(module)
    return module


def sampled(nth: int) -> pytest.MarkDecorator:
    """Take every `nth` case before each commit, and all of them as a study."""
    every = pytest.param(1, id="all", marks=pytest.mark.study)
    return pytest.mark.parametrize("nth", [pytest.param(nth, id="sample"), every])


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    path = metafunc.config.getoption("--stand")
    if "bench" in metafunc.fixturenames:
        known = [pytest.param(name, marks=marks_of(name)) for name in (*IN_VIRTUAL_TIME, *OTHERS)]
        metafunc.parametrize("bench", known if path is None else [Path(path)], indirect=True, ids=str)
    if "wired" in metafunc.fixturenames:
        on_wires = [pytest.param(name, marks=marks_of(name)) for name in IN_VIRTUAL_TIME]
        metafunc.parametrize("wired", [] if path else on_wires, indirect=True)


@pytest.fixture
def wired(request: pytest.FixtureRequest) -> Iterator[Wired]:
    """Every servo that talks over an emulated wire in virtual time."""
    made = IN_VIRTUAL_TIME[request.param]()
    yield made
    made.servo.close()


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Servo, Limits]]:
    """Every servo the contract is held against, each with limits that suit it; with --stand that stand alone."""
    if isinstance(request.param, Path):
        yield from on_a_stand(request.param)
    elif request.param in OTHERS:
        yield from OTHERS[request.param](tmp_path)
    else:
        made = IN_VIRTUAL_TIME[request.param]()
        yield from closed_after(made.servo, made.limits)
