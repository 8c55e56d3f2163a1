"""Programs that nobody here wrote, against every emulated drive: python benchmarks/compatibility.py

Each session identifies a drive, switches it on, commands it, reads its state and switches it off. The table is written
to docs/compatibility.md; tests/drivers/test_clients.py runs one model of each. A client that is not installed is left
out, and so is a model that the client does not know.
"""

from __future__ import annotations

import asyncio
import importlib
import io
import os
import subprocess
import sys
import tempfile
import time
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from sim_backend.wire.dynamixel.tables import MODELS as X_MODELS  # noqa: E402 - found through ROOT
from sim_backend.wire.dynamixel.tables import MX_MODELS  # noqa: E402
from sim_backend.wire.feetech.tables import MODELS as FEETECH_MODELS  # noqa: E402

BAUD = 1_000_000
UNKNOWN = "model not known to it"
LEROBOT_X = ["xl330-m077", "xl330-m288", "xl430-w250", "xc430-w150", "xm430-w350", "xm540-w270"]
ROBSTRIDE = [f"rs0{n}" for n in range(7)]
DAMIAO = {"dm-j4310": "4310", "dm-j4340": "4340", "dm-j6006": "6006", "dm-j8009": "8009", "dm-h3510": "H3510"}


class Unsupported(Exception):
    """The client does not know the model."""


@dataclass(frozen=True)
class Session:
    """client: the package. backend, models: words and --model of `hil emulate`. talk: the session on link and model."""

    client: str
    backend: str
    models: list[str]
    talk: Callable[[str, str], None]


def require(condition: object, what: str) -> None:
    """Raise AssertionError with `what` where the condition does not hold."""
    if not condition:
        raise AssertionError(what)


def of_dynamixel_sdk(link: str, model: str) -> None:
    """The vendor's SDK, with the registers of each protocol."""
    import dynamixel_sdk as sdk

    mx = model in MX_MODELS
    port, packets = sdk.PortHandler(link), sdk.PacketHandler(1.0 if mx else 2.0)
    torque, position = (24, 36) if mx else (64, 132)
    require(port.openPort() and port.setBaudRate(BAUD), "the port does not open")
    try:
        # it waits 36 ms, which a busy machine may take to wake the emulator up
        found = any(packets.ping(port, 1)[1] == sdk.COMM_SUCCESS for _ in range(10))
        require(found, "no answer to a ping")
        for on in (1, 0):
            require(packets.write1ByteTxRx(port, 1, torque, on)[0] == sdk.COMM_SUCCESS, "torque is not set")
            require(packets.read1ByteTxRx(port, 1, torque)[0] == on, "torque is not read back")
        read = packets.read2ByteTxRx if mx else packets.read4ByteTxRx
        require(read(port, 1, position)[1] == sdk.COMM_SUCCESS, "no position")
    finally:
        port.closePort()


def of_rustypot(link: str, model: str) -> None:
    """Rust's serialport crate and rustypot's own protocol code."""
    import rustypot

    known = rustypot.find_model(model)
    if known is None:
        raise Unsupported
    number, definition = known
    with rustypot.Bus(link, BAUD, 1.0, {1: definition}) as bus:  # patience on a busy machine
        # it waits a few ms for each id, which a busy machine may take to wake the emulator up
        found = any(bus.scan(definition, [1, 2]) == {1: number} for _ in range(10))
        require(found, "the scan does not find it")
        for on in (True, False):
            require(not bus.set_torque([1], on), "torque is not set")
            require(bool(bus.read_register(1, "torque_enable")) is on, "torque is not read back")
        bus.sync_read_register([1], "present_position") if model not in MX_MODELS else None
        bus.read_register(1, "present_position")


def of_moteus(link: str, _model: str) -> None:
    """The vendor's client over python-can."""
    import moteus

    async def talk() -> None:
        transport = moteus.PythonCan(interface="slcan", channel=link)
        controller = moteus.Controller(id=1, transport=transport)
        await controller.set_stop()
        for _ in range(5):
            state = await controller.set_current(d_A=0.0, q_A=0.5, query=True)
        require(state.values[moteus.Register.MODE] == moteus.Mode.CURRENT, "no current mode")
        await controller.set_stop()
        state = await controller.query()
        require(state.values[moteus.Register.MODE] == moteus.Mode.STOPPED, "it does not stop")
        transport.close()

    asyncio.run(asyncio.wait_for(talk(), 20.0))


def of_robstride(link: str, _model: str) -> None:
    """A client for any bus of python-can."""
    import can
    from robstride import Client

    with can.Bus(interface="slcan", channel=link, bitrate=BAUD, ignore_config=True) as bus:
        client = Client(bus)
        client.enable(1)
        client.write_param(1, "limit_torque", 2.5)
        require(client.read_param(1, "limit_torque") == 2.5, "the torque limit is not read back")
        client.read_param(1, "mechpos")
        client.disable(1)


def of_robstride_dynamics(link: str, model: str) -> None:
    """The maker's client, on another bus than SocketCAN."""
    import can
    from robstride_dynamics import Motor, ParameterType, RobstrideBus

    client = RobstrideBus("none", {"joint": Motor(id=1, model=f"{model[:2]}-{model[2:]}")})
    client.channel_handler = can.Bus(interface="slcan", channel=link, bitrate=BAUD, ignore_config=True)
    try:
        require(client.read_id("joint", timeout=5.0) is not None, "no identity")
        client.enable("joint")
        client.write_operation_frame("joint", position=0.0, kp=0.0, kd=0.0, torque=0.2)
        client.read_operation_frame("joint")
        require(client.read("joint", ParameterType.MODE) == 0, "no operation mode")
    finally:
        client.disconnect()


def of_odrive_can(link: str, _model: str) -> None:
    """The package's driver, whose messages are those of firmware 0.5.6."""
    import can
    from odrive_can.odrive import ODriveCAN

    async def talk() -> None:
        with can.Bus(interface="slcan", channel=link, bitrate=500_000, ignore_config=True) as bus:
            drive = ODriveCAN(axis_id=0, can_bus=bus)
            await drive.start()
            drive.clear_errors()
            drive.set_controller_mode("TORQUE_CONTROL", "PASSTHROUGH")
            await drive.set_axis_state("CLOSED_LOOP_CONTROL")
            drive.set_input_torque(0.05)
            await asyncio.sleep(0.1)
            iq = await drive.get_iq()
            require(iq["Iq_Measured"] > 0.5, "no current")
            await drive.set_axis_state("IDLE")
            drive.stop()
            await asyncio.sleep(0.1)

    asyncio.run(asyncio.wait_for(talk(), 20.0))


def of_canopen(link: str, model: str) -> None:
    """The library's CiA 402 node, with the electronic data sheet of the drive."""
    import canopen
    from canopen.objectdictionary import import_od
    from canopen.profiles.p402 import BaseNode402

    from sim_backend.wire.cia402.device import Cia402Device

    sheet = io.StringIO(Cia402Device(model, 1).eds)
    sheet.name = "drive.eds"
    network = canopen.Network()
    network.connect(interface="slcan", channel=link, bitrate=BAUD, ignore_config=True)
    try:
        node: Any = BaseNode402(1, import_od(sheet, node_id=1))  # type: ignore[no-untyped-call]  # typed in parts
        network.add_node(node)
        node.nmt.state = "PRE-OPERATIONAL"
        node.sdo[0x1017].raw = 20
        node.nmt.wait_for_heartbeat(2.0)
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        node.state = "OPERATION ENABLED"
        require(node.sdo[0x6041].raw & 0x6F == 0x27, "it is not enabled")
        node.state = "SWITCH ON DISABLED"
    finally:
        network.disconnect()


def of_damiao_motor(link: str, model: str) -> None:
    """The package's motor, on a bus of python-can."""
    import can
    from damiao_motor.core.motor import DaMiaoMotor

    with can.Bus(interface="slcan", channel=link, bitrate=BAUD, ignore_config=True) as bus:
        motor = DaMiaoMotor(motor_id=1, feedback_id=0, bus=bus, motor_type=DAMIAO[model])

        def state() -> Any:
            message = bus.recv(2.0)
            require(message is not None, "no answer")
            return motor.decode_sensor_feedback(bytes(message.data)) if message is not None else None

        motor.enable()
        require(state()["status_code"] == 1, "it is not enabled")
        motor.send_cmd_mit(feedforward_torque=0.1)
        require(state() is not None, "no state")
        motor.disable()
        require(state()["status_code"] == 0, "it is not disabled")


def of_pydamiao(link: str, model: str) -> None:
    """The package's motor behind the USB-CAN adapter of the motor's maker."""
    from pydamiao import ControlMode, Motor, MotorType, SerialBus

    bus = SerialBus(link)
    try:
        motor = Motor(bus, MotorType[f"DM{DAMIAO[model]}"], 1, auto_disable=False)
        require(motor.set_mode(ControlMode.MIT, timeout=5.0).is_ok, "no MIT mode")
        motor.enable()
        require(motor.set_mit(kp=0.0, kd=0.0, pos=0.0, vel=0.0, torque=0.2).is_ok, "no set-point")
        time.sleep(0.2)
        require(motor.refresh_state(timeout=5.0).unwrap().torque > 0.1, "no torque")
        require(motor.disable().is_ok, "it is not disabled")
    finally:
        bus.close()


def lerobot_bus(kind: str, model: str, link: str) -> Any:
    """LeRobot's bus of a kind for one motor.

    Its buses need two functions of a module that loads torch; stand-ins are in their place, for they only ask a person.
    """
    utilities: Any = types.ModuleType("lerobot.utils.utils")
    utilities.enter_pressed, utilities.move_cursor_up = (lambda: False), (lambda _lines: None)
    sys.modules.setdefault("lerobot.utils.utils", utilities)
    from lerobot.motors.motors_bus import Motor, MotorNormMode

    module = importlib.import_module(f"lerobot.motors.{kind}")
    motors = {"joint": Motor(1, model, MotorNormMode.RANGE_M100_100)}
    if kind == "dynamixel":
        return module.DynamixelMotorsBus(link, motors)
    return module.FeetechMotorsBus(link, motors, protocol_version=1 if model.startswith("scs") else 0)


def connected(bus: Any) -> None:
    """Connect and configure; it asks once for each answer, and a busy machine may be later than the 50 ms it waits."""
    for last in (False, False, True):
        try:
            bus.connect()
            bus.configure_motors()
        except (ConnectionError, RuntimeError):
            if last:
                raise
            bus.port_handler.closePort()
        else:
            return


def of_lerobot(kind: str) -> Callable[[str, str], None]:
    """LeRobot's motor bus, as its robots use it."""

    def talk(link: str, model: str) -> None:
        bus = lerobot_bus(kind, model, link)
        connected(bus)
        raw: Any = {"normalize": False, "num_retry": 5}  # a busy machine is later than its 50 ms
        try:
            for on in (1, 0):
                (bus.enable_torque if on else bus.disable_torque)(num_retry=5)
                require(bus.read("Torque_Enable", "joint", **raw) == on, "torque is not read back")
            here = bus.read("Present_Position", "joint", **raw)
            bus.write("Goal_Position", "joint", here, **raw)
            if not model.startswith("scs"):  # they have no Sync Read, and it refuses them one
                require(bus.sync_read("Present_Position", **raw) == {"joint": here}, "another position")
        finally:
            bus.disconnect()

    return talk


def of_feetech_sdk(link: str, model: str) -> None:
    """The vendor's SDK."""
    import scservo_sdk as sdk

    class Patient(sdk.PortHandler):  # type: ignore[misc]  # it has no types
        """Its own time-out is in the wrong unit: gitee.com/ftservo/SCServoSDK IBY2S6."""

        def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802 - the SDK's name
            self.packet_start_time = self.getCurrentTime()
            self.packet_timeout = self.tx_time_per_byte * (packet_length + 3.0) + 500.0

    port, packets = Patient(link), sdk.PacketHandler(1 if model.startswith("scs") else 0)
    require(port.openPort() and port.setBaudRate(BAUD), "the port does not open")
    try:
        # it waits 36 ms, which a busy machine may take to wake the emulator up
        found = any(packets.ping(port, 1)[1] == sdk.COMM_SUCCESS for _ in range(10))
        require(found, "no answer to a ping")
        for on in (1, 0):
            require(packets.write1ByteTxRx(port, 1, 40, on)[0] == sdk.COMM_SUCCESS, "torque is not set")
            require(packets.read1ByteTxRx(port, 1, 40)[0] == on, "torque is not read back")
        require(packets.read2ByteTxRx(port, 1, 56)[1] == sdk.COMM_SUCCESS, "no position")
    finally:
        port.closePort()


SESSIONS = [
    Session("dynamixel-sdk", "dynamixel", [*X_MODELS, *MX_MODELS], of_dynamixel_sdk),
    Session("rustypot", "dynamixel", [*X_MODELS, *MX_MODELS], of_rustypot),
    Session("lerobot", "dynamixel", LEROBOT_X, of_lerobot("dynamixel")),
    Session("lerobot", "feetech", ["sts3215", "sts3250", "scs0009"], of_lerobot("feetech")),
    Session("feetech-servo-sdk", "feetech", list(FEETECH_MODELS), of_feetech_sdk),
    Session("moteus", "moteus", ["moteus"], of_moteus),
    Session("robstride", "robstride", ROBSTRIDE, of_robstride),
    Session("robstride-dynamics", "robstride", ROBSTRIDE, of_robstride_dynamics),
    Session("odrive-can", "odrive", ["0.5.6"], of_odrive_can),
    Session("canopen", "cia402", ["epos4", "epos2", "generic"], of_canopen),
    Session("damiao-motor", "mit", list(DAMIAO), of_damiao_motor),
    Session("pydamiao", "mit --bus damiao", ["dm-j4310", "dm-j4340", "dm-j6006", "dm-j8009"], of_pydamiao),
]


INSTALL = {"lerobot": "--no-deps lerobot && pip install deepdiff tqdm"}
"""How a client is installed where its name is not enough: all that LeRobot asks for is torch and more."""


def installed(client: str) -> str:
    """Return the client's version, "" where it is not installed."""
    try:
        return version(client)
    except PackageNotFoundError:
        return ""


@contextmanager
def emulated(backend: str, model: str) -> Iterator[str]:
    """Serve one drive from a process of its own; yield its link."""
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder) / "tty"
        option = {"odrive": ["--firmware", model], "moteus": []}.get(backend, ["--model", model])
        command = [sys.executable, "-m", "hil", "emulate", *backend.split(), "--link", str(link), *option]
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL, env=os.environ | {"PYTHONPATH": str(ROOT)})
        try:
            end = time.monotonic() + 60.0
            while not link.is_symlink() and time.monotonic() < end:
                time.sleep(0.02)
            yield str(link)
        finally:
            process.terminate()
            process.wait()


def result(session: Session, model: str) -> str:
    """Return what came of a session: "works", or why not."""
    with emulated(session.backend, model) as link:
        try:
            session.talk(link, model)
        except Unsupported:
            return UNKNOWN
        except Exception as error:  # noqa: BLE001 - whatever a client raises is its result
            return f"fails: {type(error).__name__}: {error}"
    return "works"


def main() -> None:
    """Run every session against every model, and write the page."""
    rows = ["| client | drive | models | result |", "| --- | --- | --- | --- |"]
    for session in SESSIONS:
        found = installed(session.client)
        models: dict[str, list[str]] = {}
        for model in session.models if found else []:
            said = result(session, model)
            print(f"{session.client} {found}, {model}: {said}", flush=True)
            models.setdefault(said, []).append(model)
        for said, named in models.items():
            rows.append(f"| {session.client} {found} | {session.backend} | {', '.join(named)} | {said} |")
    intro = (
        "# Compatibility\n\n"
        'Programs and libraries of other authors ("clients") work with the emulated drives of `hil emulate`. Each\n'
        "client identifies the drive, switches it on, reads its state and switches it off. `python\n"
        "benchmarks/compatibility.py` writes this table.\n\n"
    )
    page = Path(__file__).parent.parent / "docs" / "compatibility.md"
    behind = page.read_text(encoding="utf-8").partition("Not emulated:")
    page.write_text(f"{intro}{chr(10).join(rows)}\n\n{''.join(behind[1:])}", encoding="utf-8")


if __name__ == "__main__":
    main()
