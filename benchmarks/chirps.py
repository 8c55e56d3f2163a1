"""A chirp through every emulated wire in virtual time: Kc and Bc against the truth.

    python benchmarks/chirps.py               torque set-points, or positions with a torque cell: wire_chirps
    python benchmarks/chirps.py positions     positions and the motor's own torque: position_loop

Each plant is the paper's joint without dry friction, scaled to its motor; the truth is the coupling in series with the
fixture. The tables go into results/.
"""

from __future__ import annotations

import importlib
import math
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))


from drivers.clock import VirtualClock  # noqa: E402 - after the path
from drivers.loadcell.config import LoadCellConfig  # noqa: E402
from drivers.loadcell.sensor import LoadCell  # noqa: E402
from drivers.servo import Quantity, Servo  # noqa: E402
from ga.model.coupling import parse as coupling  # noqa: E402
from hil.acquisition import excitation  # noqa: E402
from hil.acquisition.interrupt import StopRequest  # noqa: E402
from hil.acquisition.recorder import Recorder, tick_count  # noqa: E402
from hil.identification.fitting.solution import Search  # noqa: E402
from hil.identification.identify import identify  # noqa: E402
from hil.identification.result import Identification  # noqa: E402
from hil.recording.writer import Header, RecordingWriter  # noqa: E402
from hil.stand.file import parse  # noqa: E402
from hil.stand.servo import StandServo  # noqa: E402
from sim_backend.parameters import CouplingParameters, FixtureParameters, SimParameters  # noqa: E402
from sim_backend.servo import SimServo  # noqa: E402
from sim_backend.wire.cia402 import tables as cia402  # noqa: E402
from sim_backend.wire.default_joint import scaled_joint  # noqa: E402
from sim_backend.wire.dynamixel.tables import MODELS, MX_MODELS  # noqa: E402
from sim_backend.wire.feetech.tables import MODELS as FEETECH  # noqa: E402
from sim_backend.wire.loadcell.emulator import SCALE, EmulatedLoadCell, LoadCellBoard  # noqa: E402
from sim_backend.wire.mit.tables import MODELS as MIT  # noqa: E402
from sim_backend.wire.moteus.command import TORQUE_CONSTANT  # noqa: E402
from sim_backend.wire.odrive import device as odrive  # noqa: E402
from sim_backend.wire.robstride.tables import MODELS as ROBSTRIDE  # noqa: E402

KC, BC = 17.75e-3, 0.19e-3
COUPLING = CouplingParameters(stiffness=KC, damping=BC, coulomb_friction=0.0)
STIFF = CouplingParameters(stiffness=1.0, damping=20e-3, coulomb_friction=0.0)
STRONG = STIFF.stiffness / KC
DURATION, BAND, RATE = 10.0, (0.1, 10.0), 250.0
BOARD = LoadCellBoard(rate=1000.0, baudrate=921_600)
CLOSE = (0.01, 0.03)
STAND = """
[stand]
gear_ratio = {gear}
motor_inertia = {inertia}
motor_damping = {damping}
torque_source = "{source}"
torque_stays_on_if_host_dies = true
[limits]
torque = {limit}
deflection = 2.0
velocity = 100.0
temperature = 85.0
"""


RIGS: Any = importlib.import_module("tests.drivers.conftest")
"""The benches of the drivers' tests: every adapter over its emulator, in virtual time."""


@dataclass(frozen=True)
class Bench:
    """A drive over its wire. make: its rig. size: N m at the joint; kc, bc: of its coupling. open: keys of its table.

    gear: of the stand. inertia, damping: of its motor. cell: whether the torque is a cell's. scale: of its fixture.
    position: keys of its table for positions, None where it takes none.
    """

    name: str
    make: Callable[[], Any]
    size: float
    kc: float = KC
    bc: float = BC
    gear: float = 1.0
    inertia: float = 3.2e-6
    damping: float = 1.6e-6
    open: tuple[tuple[str, Any], ...] = ()
    cell: bool = False
    position: tuple[tuple[str, Any], ...] | None = None
    scale: float = 1.0

    @property
    def truth(self) -> tuple[float, float]:
        """Kc and Bc in series with the fixture, at low frequencies."""
        held = FixtureParameters()
        stiffness, damping = self.scale * held.stiffness, self.scale * held.damping
        kc = 1.0 / (1.0 / self.kc + 1.0 / stiffness)
        return kc, kc**2 * (self.bc / self.kc**2 + damping / stiffness**2)


def held(joint: SimParameters, scale: float) -> SimParameters:
    """The joint in a fixture `scale` times as strong as the paper's: two springs in series are not one."""
    own = FixtureParameters()
    fixture = FixtureParameters(own.stiffness * scale, own.damping * scale, own.inertia * scale)
    return replace(joint, fixture=fixture)


def of_dynamixel(model: str) -> Bench:
    spec = (MODELS | MX_MODELS)[model]
    _, amperes, torque = spec.stall
    stiff = model.startswith("mx") or torque > 2.0
    joint = held(RIGS.small_joint(STIFF if stiff else COUPLING), STRONG if stiff else 1.0)
    return Bench(
        f"dynamixel {model}",
        lambda: RIGS.new_rig(model, parameters=joint),
        size=0.35 if stiff else 0.01,
        kc=STIFF.stiffness if stiff else KC,
        bc=STIFF.damping if stiff else BC,
        open=(("torque_constant", torque / amperes),),
        position=None if model.startswith("mx") else (("mode", "extended-position"),),
        scale=STRONG if stiff else 1.0,
    )


def of_feetech(model: str) -> Bench:
    spec = FEETECH[model]
    if model.startswith("hls"):
        joint = held(RIGS.small_joint(STIFF), STRONG)
        constant = spec.stall[2] / spec.stall[1]
        return Bench(
            f"feetech {model}",
            lambda: RIGS.feetech_rig(model, parameters=joint),
            size=0.35,
            kc=STIFF.stiffness,
            bc=STIFF.damping,
            open=(("torque_constant", constant),),
            position=(("mode", "position"),),
            scale=STRONG,
        )

    def make() -> Any:
        rig = RIGS.feetech_rig(model, parameters=RIGS.small_joint(COUPLING))
        rig.device.write(40, b"\x80")  # its middle is here: the set-points stay within its single turn
        return rig

    return Bench(f"feetech {model}, 1 kHz cell", make, size=0.8, cell=True)


def on_can(name: str, make: Callable[[SimParameters], Any], scale: float, constant: float, ohm: float) -> Bench:
    joint = scaled_joint(scale, constant, ohm, friction=False)
    return Bench(
        name,
        lambda: make(joint),
        size=0.01 * scale,
        kc=KC * scale,
        bc=BC * scale,
        inertia=3.2e-6 * scale,
        damping=1.6e-6 * scale,
        scale=scale,
    )


@dataclass(frozen=True)
class Simulated:
    """The simulated servo as a rig."""

    parameters: SimParameters

    def open(self) -> Servo:
        servo: Servo = SimServo(self.parameters, seed=0, clock=VirtualClock())
        return servo


def benches() -> list[Bench]:
    paper = SimParameters(coupling=COUPLING)
    commander = Bench(
        "commander",
        lambda: RIGS.new_foc(parameters=paper),
        size=0.01,
        gear=4.0,
        inertia=2.0e-7,
        damping=1.0e-7,
    )
    moteus_bench = on_can("moteus", lambda joint: RIGS.moteus_rig(parameters=joint), 20.0, TORQUE_CONSTANT, 0.1)
    return [
        *(of_dynamixel(model) for model in ("xl330-m077", "xl330-m288", "xc330-m288", "xm430-w350", "xm540-w270")),
        *(of_dynamixel(model) for model in ("mx-64", "mx-106")),
        *(of_feetech(model) for model in ("sts3215", "sts3250", "scs0009", "hls3930m")),
        *(
            on_can(
                f"odrive {firmware}",
                lambda joint, firmware=firmware: RIGS.odrive_rig(firmware, parameters=joint),
                20.0,
                odrive.TORQUE_CONSTANT,
                0.06,
            )
            for firmware in ("0.5.6", "0.6.10")
        ),
        *(
            on_can(
                f"mit {model}",
                lambda joint, model=model: RIGS.mit_rig(model, parameters=joint),
                10.0 * MIT[model].span[2],
                MIT[model].torque_constant,
                MIT[model].resistance,
            )
            for model in ("ak80-9", "dm-j4310")
        ),
        *(
            on_can(
                f"robstride {model}",
                lambda joint, model=model: RIGS.robstride_rig(model, parameters=joint),
                10.0 * ROBSTRIDE[model].span[1],
                ROBSTRIDE[model].torque_constant,
                ROBSTRIDE[model].resistance,
            )
            for model in ("rs00", "rs03", "el05")
        ),
        Bench(**(moteus_bench.__dict__ | {"position": (("mode", "position"),)})),
        *(
            on_can(
                f"cia402 {model}",
                lambda joint, model=model: RIGS.cia402_rig(model, parameters=joint),
                2.0,
                cia402.TORQUE_CONSTANT,
                0.6,
            )
            for model in ("epos4", "epos2", "generic")
        ),
        commander,
        Bench(
            "sim, motor torque", lambda: Simulated(paper), 0.01, gear=4.0, inertia=2.0e-7, damping=1.0e-7, position=()
        ),
    ]


def recorded(
    bench: Bench, quantity: Quantity, path: Path, *, kind: str = "chirp", duration: float = DURATION, rate: float = RATE
) -> Servo:
    """Record the bench into `path`; return the servo, closed. Raises AssertionError where it did not end well."""
    rig = bench.make()
    servo = rig.open(**dict(bench.position or () if quantity is Quantity.POSITION and not bench.cell else bench.open))
    swing = bench.size if quantity is Quantity.TORQUE or bench.cell else bench.size / bench.kc
    if bench.cell:
        servo = with_cell(rig, servo)
    text = STAND.format(
        gear=bench.gear,
        inertia=bench.inertia,
        damping=bench.damping,
        source="joint" if bench.cell else "motor",
        limit=3.0 * max(bench.size, bench.kc * swing),
    )
    profile = excitation.make(
        kind, quantity, amplitude=swing, default_amplitude=swing, duration=duration, band=BAND, rate=rate, seed=0
    )
    header = Header(profile=profile.attributes() | {"rate": rate}, stand_toml=text)
    part = RecordingWriter(path, header, tick_count(profile, rate))
    outcome = Recorder(parse(text), servo, profile, rate, part).run(StopRequest())
    servo.close()
    part.finish(outcome.end_reason)
    part.close()
    assert (outcome.end_reason, outcome.lost, outcome.late) == ("done", 0, 0), f"{outcome.end_reason}: {outcome.error}"
    return servo


def driven(bench: Bench, quantity: Quantity, model: str, *, kind: str = "chirp") -> Identification:
    """What a recording of the bench identifies."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        recorded(bench, quantity, path, kind=kind)
        return identify([path], coupling(model), Search(trials=1, workers=1))


def with_cell(rig: Any, servo: Servo) -> Servo:
    cell = EmulatedLoadCell(BOARD, rig.device, now=rig.clock.now())
    port = RIGS.SerialLoopback(cell, rig.clock, BOARD.baudrate)
    config = LoadCellConfig(port="loopback", scale=SCALE, baudrate=BOARD.baudrate)
    return StandServo(servo, 0.0, LoadCell(config, clock=rig.clock, port=port))


def errors(found: Identification, bench: Bench) -> tuple[float, float, float]:
    """The relative errors of Kc and Bc, and half the 95 % interval of Bc, relative to the truth."""
    kc, bc = bench.truth
    low, high = found["Bc"].ci95
    return found["Kc"].value / kc - 1.0, found["Bc"].value / bc - 1.0, 0.5 * (high - low) / bc


def verdict(bench: Bench, kc: float, bc: float, half: float) -> str:
    if abs(kc) <= CLOSE[0] and abs(bc) <= CLOSE[1]:
        return "within 1 % and 3 %"
    servo = bench.make().open(**dict(bench.open))
    lsb = servo.info.torque_lsb * bench.gear
    servo.close()
    count = f"one count of torque is {lsb / (2.0 * bench.size):.1%} of the swing" if math.isfinite(lsb) else ""
    return f"{count}{'; ' if count else ''}the interval of Bc is +- {half:.1%}"


def wires() -> None:
    from page import machine, write_result  # here: tests import this script from another folder

    rows = ["| drive | Kc | Bc | |", "| --- | --- | --- | --- |"]
    for bench in benches():
        quantity = Quantity.POSITION if bench.cell else Quantity.TORQUE
        try:
            kc, bc, half = errors(driven(bench, quantity, "linear+offset+skew"), bench)
            rows.append(f"| {bench.name} | {kc:+.2%} | {bc:+.1%} | {verdict(bench, kc, bc, half)} |")
        except Exception as error:  # noqa: BLE001 - whatever stops it belongs into the table
            rows.append(f"| {bench.name} | | | {type(error).__name__}: {error} |")
        print(rows[-1], flush=True)
    about = "Errors of linear+offset+skew on 10 s of a chirp from 0.1 to 10 Hz at 250 Hz through each wire, seed 0."
    write_result("wire_chirps", "\n".join([f"{machine()}.", about, "", *rows]))


def positions() -> None:
    from page import machine, write_result  # here: as above

    rows = [
        "| drive | Kc, Bc at 250 Hz | and with a skew | ramp: Kc | torque set-points: Kc, Bc |",
        "| --- | --- | --- | --- | --- |",
    ]
    cases = [("linear+offset", Quantity.POSITION, "chirp"), ("linear+offset+skew", Quantity.POSITION, "chirp")]
    cases += [("linear+offset", Quantity.POSITION, "ramp"), ("linear+offset+skew", Quantity.TORQUE, "chirp")]
    for bench in (bench for bench in benches() if bench.position is not None):
        cells = []
        for model, quantity, kind in cases:
            try:
                found = driven(bench, quantity, model, kind=kind)
                kc, bc, _ = errors(found, bench)
                cells.append(f"{kc:+.1%}" if kind == "ramp" else f"{kc:+.1%}, {bc:+.0%}")
            except Exception as error:  # noqa: BLE001 - whatever stops it belongs into the table
                cells.append(f"{type(error).__name__}: {error}")
        rows.append(f"| {bench.name} | {' | '.join(cells)} |")
        print(rows[-1], flush=True)
    about = "Errors of linear+offset (with a skew: linear+offset+skew), 10 s of positions from 0.1 to 10 Hz, seed 0."
    write_result("position_loop", "\n".join([f"{machine()}.", about, "", *rows]))


if __name__ == "__main__":
    positions() if sys.argv[1:] == ["positions"] else wires()
