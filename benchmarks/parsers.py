"""Every parser of what others wrote, as a function of bytes, for benchmarks/fuzz.py and tests/project/test_fuzz.py.

Each returns where it reads or declines the bytes, and raises nothing but what a person or the recorder expects.
"""

from __future__ import annotations

import csv
import gzip
import io
import json
import os
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from scipy.io import savemat

from drivers.clock import VirtualClock
from drivers.commander import lines as commander
from drivers.dynamixel.wire import Wire2
from drivers.feetech.block import Block
from drivers.feetech.faults import ALERTS
from drivers.feetech.models import models as feetech_models
from drivers.loadcell.lines import parsed
from drivers.mit.frames import Codec as MitCodec
from drivers.moteus import frames as moteus
from drivers.odrive import messages as odrive
from drivers.packets.port import SerialPort
from drivers.packets.wire import Wire, Wire1
from drivers.robstride.frames import Codec as RobstrideCodec
from drivers.servo import DriverError, ServoInfo
from drivers.uart.lines import TextLines
from ga.bounds import Bounds
from ga.evolution.evolution import Settings
from ga.evolution.population import Population
from ga.trials import checkpoint
from hil.acquisition.heat import HeatMemory
from hil.calibration.points import read_points
from hil.campaign import plan
from hil.campaign.journal import NAME, Journal
from hil.errors import Untrustworthy, WrongUse
from hil.exchange.coupling import of_result
from hil.exchange.exporter import export
from hil.exchange.readers import bags, formats
from hil.exchange.row_filter import RowFilter
from hil.exchange.text import rows
from hil.recording.channels import Row
from hil.recording.writer import Header, RecordingWriter
from hil.stand import fault_file
from hil.stand.file import SIMULATED, parse
from hil.stand.winding import WindingModel
from hil.units import quantity
from sim_backend.wire.packets.frames import status

DECLINED = (WrongUse, Untrustworthy, DriverError, checkpoint.WrongCheckpoint)
OTHERS = ("pydantic", "[Errno", "Input should", "object at 0x", "<class", "Traceback")
LONGEST = 5000  # characters of a message

_REMOVED_AT_EXIT = tempfile.TemporaryDirectory()
_FOLDER = Path(_REMOVED_AT_EXIT.name)
_CELL = "[sim.sensors]\n"
_PLAN = (
    '[campaign]\nname = "hand"\noutput = "hand"\n[[joint]]\nname = "index"\nstand = "sim"\n[[profile]]\nname = "p"\n'
)
_BELONGS = checkpoint.belonging(
    np.zeros((2, 3)), np.zeros(3), bounds=Bounds(np.zeros(2), np.ones(2)), settings=Settings(), seed=0, trials=1
)


class Parser(NamedTuple):
    """A parser: how it reads bytes, bytes that it takes for good, and whether it reads text."""

    read: Callable[[bytes], object]
    seeds: tuple[bytes, ...]
    is_text: bool = False


class _Line(io.BytesIO):
    """A serial line on which all bytes have arrived."""

    baudrate = 1_000_000

    @property
    def in_waiting(self) -> int:
        return len(self.getbuffer()) - self.tell()


def _packets(wire: Wire) -> Callable[[bytes], object]:
    clock = VirtualClock()

    def read(data: bytes) -> object:
        port: Any = SerialPort("fuzz", 1_000_000, clock)
        port.ser = _Line(data)
        port.expect(clock.now() + 0.01, wire.status_size)
        port.isPacketTimeout = lambda: not port.ser.in_waiting
        list(wire.pings(data))
        with suppress(IndexError):  # `Bus` expects it of the SDK
            raw, result = wire.receive(port)
            return wire.opened(raw) if not result else None
        return None

    return read


def _lines(data: bytes) -> None:
    lines = TextLines()
    for line in [*lines.feed(data[: len(data) // 2]), *lines.feed(data[len(data) // 2 :])]:
        commander.state(line)
        commander.number(line)
        for form in ("value", "micros_raw"):
            with declining():
                parsed(line, form)  # type: ignore[arg-type]  # a Literal of the table


def _odrive(data: bytes) -> None:
    for codec in _ODRIVE:
        for name in odrive.messages(codec.layout):
            with declining():
                codec.decoded(name, data)
        if len(data) >= 4:
            codec.name_of(struct.unpack_from("<I", data)[0], extended=False, remote=False)


_ODRIVE = (odrive.Codec(3, "0.5"), odrive.Codec(3, "0.6"))
_ROBSTRIDE = RobstrideCodec(12.5, 33.0, 14.0)
_MIT = (MitCodec("damiao", 12.5, 30.0, 10.0), MitCodec("cubemars", 12.5, 30.0, 10.0))
_BLOCKS = {name: Block(model) for name, model in feetech_models().items()}


def _mit(data: bytes) -> None:
    for codec in _MIT:
        with declining():
            state = codec.state(data)
            assert not abs(state.position) > 12.5 + 1e-9  # NaN at an end of the range
            assert abs(state.torque) <= 10.0 + 1e-9


def _robstride(data: bytes) -> None:
    with declining():
        state = _ROBSTRIDE.state(int.from_bytes(data[:2], "big"), data[2:])
        assert not abs(state.position) > 12.5 + 1e-9
        assert abs(state.torque) <= 14.0 + 1e-9


def _moteus(data: bytes) -> None:
    with declining():
        found = moteus.answers(data)
        for name in found:
            found.whole(name)
    with declining():
        moteus.console_text(data)


def _feetech(data: bytes) -> None:
    for block in _BLOCKS.values():
        address, size = block.request(0.0)
        assert address + size <= 72
        block.state(data.ljust(size, b"\0")[:size])


@contextmanager
def declining() -> Iterator[None]:
    """Let bytes be declined, in a sentence."""
    try:
        yield
    except DECLINED as error:
        text = str(error)
        assert text.strip()
        assert len(text) < LONGEST, text[:200]
        assert not any(other in text for other in OTHERS), text


def _file(name: str, work: Callable[[Path], object]) -> Callable[[bytes], object]:
    path = _FOLDER / name
    path.parent.mkdir(parents=True, exist_ok=True)

    def read(data: bytes) -> object:
        path.write_bytes(data)
        return work(path)

    return read


def _table(path: Path) -> None:
    form = rows.form(path)
    rows.read(path, form, form.names, range(min(3, len(form.names))), [])


def _heat(_path: Path) -> None:
    with patch.dict(os.environ, XDG_STATE_HOME=str(_FOLDER / "state")):
        HeatMemory(parse(SIMULATED), _DRIVE).load(_WINDING, 1.7e9)


def _journal(_path: Path) -> None:
    journal = Journal(_LOADED)
    for run in _LOADED.runs:
        journal.failure(run)


def _text(work: Callable[[str], object]) -> Callable[[bytes], object]:
    return lambda data: work(data.decode("utf-8", "surrogateescape"))


def _stand(text: str) -> object:
    return parse(text, "stand.toml")


def _quantity(text: str) -> None:
    for dimensions in (("torque", "angle"), ("time",), ("stiffness",), ("mass",)):
        with declining():
            value, _ = quantity(text, *dimensions)
            assert np.isfinite(value), text


def _bytes_of(save: Callable[[Path], object], name: str) -> bytes:
    path = _FOLDER / name
    save(path)
    return path.read_bytes()


def _saved(path: Path) -> None:
    fields = [np.zeros((4, 2))] + [np.zeros(4) for _ in Population._fields[1:]]
    checkpoint.save(path, _BELONGS, checkpoint.SearchState([Population(*fields)], np.zeros((1, 3))))


def _mcap(path: Path) -> None:
    made = RecordingWriter(path.with_suffix(".h5"), Header(profile={"kind": "chirp"}), 9)
    for seq in range(5):
        made.append(Row(seq, time=seq / 100.0, torque=0.1, dtheta=0.2))
    export(made.finish("done"), path, force=True)


def _csv_text() -> bytes:
    out = io.StringIO()
    csv.writer(out).writerows([("t [s]", "q [mN*m]", "p [deg]"), *((n / 500, n * 0.1, n * 0.2) for n in range(9))])
    return out.getvalue().encode()


def _loaded_plan() -> plan.Plan:
    path = _FOLDER / "plan.toml"
    path.write_text(_PLAN)
    return plan.load(path)


_DRIVE = ServoInfo("dynamixel", "xl330", "7")
_WINDING = WindingModel(40.0, 0.0039, (3.0, 2.0), (9.0, 30.0), 25.0)
_LOADED = _loaded_plan()
_T = np.arange(20) / 100.0
_RESULT = {
    "schema": "hil-identification/2",
    "model": "linear",
    "recordings": ["a.h5"],
    "errors": [],
    "parameters": {n: {"value": 1.0, "unit": "u", "ci95": [0.9, 1.1], "trusted": True} for n in ("Kc", "Bc")},
}
_STATUS = status(1, 0, bytes.fromhex("a6000000"))
_JOURNAL = {"schema": "hil-campaign-journal/1", "runs": {"index_p_1": {"key": "0", "failure": ""}}}
_HEAT = {"time": 1.69e9, "winding_degC": 50.0, "case_degC": 40.0}

PARSERS: dict[str, Parser] = {
    "dynamixel 2": Parser(_packets(Wire2()), (_STATUS, status(2, 0x80, b"\xff\xff\xfd\x00"))),
    "dynamixel 1, feetech": Parser(_packets(Wire1(ALERTS)), (b"\xff\xff\x01\x04\x00\x18\x05\xdd",)),
    "feetech block": Parser(_feetech, (bytes(range(20)),)),
    "mit": Parser(_mit, (bytes.fromhex("117fff7ff7ff1e1f"), bytes.fromhex("017fff7ff7ff"))),
    "robstride": Parser(_robstride, (bytes.fromhex("8001a6d4808c7fff0140"),)),
    "moteus": Parser(_moteus, (bytes.fromhex("2400000a000000ff7f0000230d181e0050"), b"\x41\x01\x03abc")),
    "odrive": Parser(_odrive, (bytes(8), struct.pack("<ff", 1.0, 2.0))),
    "board lines": Parser(_lines, (b"1.00000;0.1;2\n1.00000\n", b"123456,-4567\n", b"12.5*3f\r\n"), is_text=True),
    "stand": Parser(_text(_stand), (SIMULATED.encode(), (SIMULATED + _CELL).encode()), is_text=True),
    "plan": Parser(_file("a_plan.toml", plan.load), (_PLAN.encode(),), is_text=True),
    "faults": Parser(
        _file("faults.toml", fault_file.load_plan), (b'[[fault]]\nkind = "drop"\nat = 0.2\n',), is_text=True
    ),
    "csv": Parser(_file("t.csv", _table), (_csv_text(), b"a;b\n1,5;2\n", "t;q\n1;2\n".encode("utf-16")), is_text=True),
    "csv.gz": Parser(_file("t.csv.gz", _table), (gzip.compress(_csv_text(), mtime=0),)),
    "mat": Parser(
        _file("t.mat", lambda path: formats.columns(path, "matlab")),
        (
            _bytes_of(lambda path: savemat(path, {"t": _T, "s": {"q": _T}}), "seed.mat"),
            _bytes_of(lambda path: savemat(path, {"t": _T}, do_compression=True), "packed.mat"),
        ),
    ),
    "mcap": Parser(_file("t.mcap", lambda path: bags.columns(path, None, None)), (_bytes_of(_mcap, "seed.mcap"),)),
    "weights": Parser(
        _file("w.csv", lambda path: read_points(path, 0.05)), (b"mass [g],value\n100,5\n-100,7\n",), is_text=True
    ),
    "heat": Parser(_file("state/hil/heat/dynamixel_xl330_7.json", _heat), (json.dumps(_HEAT).encode(),), is_text=True),
    "journal": Parser(_file(f"hand/{NAME}", _journal), (json.dumps(_JOURNAL).encode(),), is_text=True),
    "result": Parser(_file("result.json", of_result), (json.dumps(_RESULT).encode(),), is_text=True),
    "checkpoint": Parser(
        _file("c.npz", lambda path: checkpoint.load(path, _BELONGS)), (_bytes_of(_saved, "seed.npz"),)
    ),
    "quantity": Parser(_text(_quantity), (b"5 mN*m", b"0.1 deg", b"1e3"), is_text=True),
    "row filter": Parser(_text(RowFilter.parse), (b"test_nr==100", b"t>=1e3"), is_text=True),
}


def read(parser: Parser, data: bytes) -> None:
    """Let a parser read bytes. Raises what is a breach."""
    with declining():
        parser.read(data)
