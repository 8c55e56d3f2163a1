"""Files of every kind that a person may name by mistake, recordings that no bench makes, and tables drawn at random.

Run it as `python benchmarks/odd_files.py --count 50000`: each drawn table is imported, and must be read right or
refused. The last line counts the tables that were read right, refused, and read wrong; with one read wrong the exit
status is 1.
"""

from __future__ import annotations

import argparse
import math
import os
import struct
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from hil import units
from hil.api.runs import record
from hil.errors import WrongUse
from hil.exchange.importer import Column, understand
from hil.recording.channels import Row
from hil.recording.writer import Header, RecordingWriter
from hil.stand.file import SIMULATED

Array = NDArray[np.float64]
RATE = 200.0  # Hz

PLAN = """[campaign]
name = "hand"
output = "hand"
[[joint]]
name = "index"
stand = "sim"
[[profile]]
name = "fast"
kind = "chirp"
duration = 1.0
fade = 0.1
"""


def _sine(count: int) -> dict[str, Array]:
    t = np.arange(count) / RATE
    angle = 0.3 * np.sin(9.0 * t) + 0.1 * np.sin(40.0 * t)
    rate = 2.7 * np.cos(9.0 * t) + 4.0 * np.cos(40.0 * t)
    noise = np.random.default_rng(1).normal(0.0, 1e-4, count)
    return {"time": t, "dtheta": angle, "torque": 0.02 * angle + 2e-4 * rate + noise}


def _changed(**changes: Callable[[Array], Array]) -> dict[str, Array]:
    table = _sine(600)
    return table | {name: change(table[name].copy()) for name, change in changes.items()}


def _put(at: slice | int, value: float) -> Callable[[Array], Array]:
    def change(column: Array) -> Array:
        column[at] = value
        return column

    return change


ROWS: dict[str, Callable[[], dict[str, Array]]] = {
    "rows0": lambda: _sine(0),
    "rows1": lambda: _sine(1),
    "rows2": lambda: _sine(2),
    "rows3": lambda: _sine(3),
    "rows9": lambda: _sine(9),
    "rows40": lambda: _sine(40),
    "sine": lambda: _sine(600),
    "nan_torque": lambda: _changed(torque=_put(slice(None), math.nan)),
    "some_nan": lambda: _changed(dtheta=_put(slice(10, 400, 3), math.nan)),
    "inf_torque": lambda: _changed(torque=_put(77, math.inf)),
    "inf_time": lambda: _changed(time=_put(77, math.inf)),
    "nan_time": lambda: _changed(time=_put(77, math.nan)),
    "all_nan_time": lambda: _changed(time=_put(slice(None), math.nan)),
    "constant": lambda: _changed(dtheta=_put(slice(None), 0.1), torque=_put(slice(None), 0.002)),
    "constant_angle": lambda: _changed(dtheta=_put(slice(None), 0.1)),
    "constant_torque": lambda: _changed(torque=_put(slice(None), 0.0)),
    "backwards": lambda: _changed(time=lambda t: t[::-1].copy()),
    "jump_back": lambda: _changed(time=_put(300, 0.0)),
    "same_time": lambda: _changed(time=_put(slice(None), 3.0)),
    "doubled": lambda: _changed(time=lambda t: np.repeat(t[::2], 2)),
    "long_gap": lambda: _changed(time=lambda t: np.where(t > 1.0, t + 1e9, t)),
    "huge_time": lambda: _changed(time=lambda t: t * 1e300),
    "tiny_time": lambda: _changed(time=lambda t: t * 1e-300),
    "late_time": lambda: _changed(time=lambda t: t + 1e17),
    "huge": lambda: _changed(torque=lambda q: q * 1e300, dtheta=lambda p: p * 1e300),
    "huge_torque": lambda: _changed(torque=lambda q: q * 1e300),
    "huge_angle": lambda: _changed(dtheta=lambda p: p * 1e200),
    "tiny": lambda: _changed(torque=lambda q: q * 1e-300, dtheta=lambda p: p * 1e-300),
    "tiny_torque": lambda: _changed(torque=lambda q: q * 1e-300),
    "tiny_angle": lambda: _changed(dtheta=lambda p: p * 1e-300),
    "one_outlier": lambda: _changed(torque=_put(300, 1e300)),
    "largest": lambda: _changed(torque=_put(slice(0, 600, 2), 1.7e308), dtheta=_put(slice(1, 600, 2), -1.7e308)),
    "counts": lambda: _changed(dtheta=lambda p: np.round(p * 3.0) / 3.0),
    "negative": lambda: _changed(torque=lambda q: -q),
}


def make_files(folder: Path, *, few: bool = False) -> None:
    """Make the folder with all files. few: with recordings of some of the rows only."""
    folder.mkdir()
    record("sim", duration=2.0, rate=RATE, fade=0.2, output=folder / "good.h5", force=True)
    for name, rows in [*ROWS.items()][:: 6 if few else 1]:
        table = rows()
        _recording(folder / f"{name}.h5", table)
        _csv(folder / f"{name}.csv", table)
    savemat(folder / "good.mat", {"t": _sine(600)["time"], "q": _sine(600)["torque"], "p": _sine(600)["dtheta"]})
    _part(folder / "unfinished.h5")
    _of_other_kinds(folder)
    _of_no_kind(folder)


def _recording(path: Path, table: dict[str, Array]) -> None:
    _begun(path, table).finish("done")


def _part(path: Path) -> None:
    made = _begun(path, _sine(300))
    made.flush()
    made.close()


def _begun(path: Path, table: dict[str, Array]) -> RecordingWriter:
    count = len(table["time"])
    profile = {"kind": "chirp", "mode": "torque", "amplitude": 0.006, "rate": RATE, "duration": 3.0, "fade": 0.1}
    made = RecordingWriter(path, Header(profile=profile, stand_toml=SIMULATED), count + 10)
    for seq in range(count):
        made.append(Row(seq, **{name: float(column[seq]) for name, column in table.items()}))
    return made


def _csv(path: Path, table: dict[str, Array]) -> None:
    columns = [table[name].tolist() for name in ("time", "torque", "dtheta")]
    lines = [f"{t!r},{q!r},{p!r}" for t, q, p in zip(*columns, strict=True)]
    path.write_text("\n".join(["t [s],q [N*m],p [rad]", *lines]) + "\n")


def _of_other_kinds(folder: Path) -> None:
    (folder / "stand.toml.txt").write_text(SIMULATED)
    (folder / "sim.toml").write_text(SIMULATED)
    (folder / "plan.toml").write_text(PLAN)
    (folder / "drive.toml").write_text(
        '[stand]\nbackend = "dynamixel"\n[limits]\ntorque = 0.5\ndeflection = 1.0\nvelocity = 10.0\n'
        '[dynamixel]\nport = "/dev/nothing"\nmodel = "xl330-m288"\n'
    )
    (folder / "faults.toml").write_text('[[fault]]\nkind = "drop"\nat = 0.2\n')
    (folder / "result.json").write_text('{"schema": "hil-identification/1", "parameters": {"Kc": {"value": null}}}')
    (folder / "model.py").write_text("Model = 3\n")
    with h5py.File(folder / "other.h5", "w") as file:
        file["x"] = np.arange(9)
    np.savez(folder / "arrays.npz", records=np.zeros(3))


def _of_no_kind(folder: Path) -> None:
    (folder / "empty").write_bytes(b"")
    (folder / "empty.h5").write_bytes(b"")
    (folder / "empty.csv").write_bytes(b"")
    (folder / "noise").write_bytes(np.random.default_rng(0).bytes(5000))
    (folder / "noise.mat").write_bytes(np.random.default_rng(0).bytes(5000))
    (folder / "noise.mcap").write_bytes(b"\x89MCAP0\r\n" + np.random.default_rng(0).bytes(5000))
    (folder / "noise.db3").write_bytes(b"SQLite format 3\0" + np.random.default_rng(0).bytes(5000))
    (folder / "noise.parquet").write_bytes(b"PAR1" + np.random.default_rng(0).bytes(500) + b"PAR1")
    (folder / "noise.toml").write_bytes(b'[stand]\nname = "\xff\xfe"\n')
    (folder / "noise.csv.gz").write_bytes(b"\x1f\x8b\x08\0" + np.random.default_rng(0).bytes(500))
    (folder / "nulls.csv").write_bytes(b"\0" * 4096)
    (folder / "text.csv").write_text("these are, only, words\n" * 30)
    (folder / "nested.toml").write_text("a = " + "[" * 5000 + "]" * 5000)
    (folder / "esc.toml").write_text('[stand]\n"\\u001b[31m" = 1\n')
    (folder / "signature.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + struct.pack("<40Q", *range(40)))
    (folder / "folder").mkdir()
    (folder / "folder.h5").mkdir()
    (folder / "link").symlink_to("good.h5")
    (folder / "loop").symlink_to("loop")
    (folder / "dangling").symlink_to("nowhere")
    (folder / "secret.h5").write_bytes(b"x")
    (folder / "secret.h5").chmod(0)
    with open(os.fsencode(folder) + b"/\xff\xfe.h5", "wb") as file:  # noqa: PTH123 - a name that is no UTF-8
        file.write(b"x")


class Drawn(NamedTuple):
    """A table drawn at random. columns: what is asked of it. true: the channels in SI, (n,) each; {}: it must be
    refused. words: what was drawn.
    """

    text: str
    columns: dict[str, Column]
    true: dict[str, Array]
    words: str


_NAMES = {
    "time": [
        "t",
        "time",
        "Time",
        "timestamp",
        "stamp",
        "clock",
        "Zeit",
        "elapsed time",
        "x-axis",
        "t_rel",
        "sample time",
    ],
    "torque": ["tau", "torque", "Moment", "cell", "load cell", "effort", "Drehmoment", "M-arm", "1", "CH1", "tau.z"],
    "dtheta": [
        "q",
        "angle",
        "joint rotation",
        "position",
        "pos",
        "theta",
        "2",
        "CH2",
        "Winkel",
        "joint/angle",
        "rev count",
    ],
    "": ["current", "num cycles", "temperature", "mode", "a", "min", "rotation speed", "in", "rev", "cell 2", "note"],
}
_UNITS = {
    "time": ["s", "ms", "us", "sec", "milliseconds", "min"],
    "torque": ["N*m", "Nm", "mN m", "mNm", "N cm", "kgf*cm", "oz-in", "lbf*in", "Nmm"],
    "dtheta": ["rad", "deg", "degrees", "mrad", "rev", "\u00b0"],
    "": ["A", "V", "degC", "counts", "%", "rpm"],
}
_DIMENSION = {"time": "time", "torque": "torque", "dtheta": "angle"}
_STYLES = ("{0} [{1}]", "{0} ({1})", "{0}/{1}", "{0}_{1}", "{0} in {1}", "{0}", "row", "option")
_ABOVE = (
    "",
    "# log of rig 7\n",
    "Model,DL850\nDate,2024/05/01\nRecord Length,4000\n",
    "a run of 3 s at 200 Hz\n\n",
    "sep=;\n",
)
_STAMPS = ("even", "jitter", "falling", "whole", "wrapped", "date", "lost")


def draw(seed: int) -> Drawn:
    """Return a table with headings, units and stamps drawn at random."""
    rng = np.random.default_rng(seed)
    pick = lambda choices: choices[int(rng.integers(len(choices)))]  # noqa: E731 - of this generator
    t, kind = np.arange(400) / RATE + 0.37, pick(_STAMPS)
    true = {"time": t, "torque": 0.1 * np.sin(9.0 * t), "dtheta": 0.2 * np.cos(11.0 * t)}
    order = [*rng.permutation(["time", "torque", "dtheta", ""])]
    style, delimiter, above = pick(_STYLES), pick((",", ";", "\t")), pick(_ABOVE)
    named = {one: pick(_NAMES[one]) for one in order}
    unit = {one: pick(_UNITS[one]) for one in order}
    stamps, written = _stamps(rng, kind, t, unit)
    cells = {"": [f"{one:.2f}" for one in rng.normal(size=len(t))], "time": stamps}
    for one, dimension in (("torque", "torque"), ("dtheta", "angle")):
        cells[one] = [f"{value:.9g}" for value in true[one] / units.factor(dimension, unit[one])]
    form = "{0}" if style in {"row", "option"} else style
    heads = [named[one] if one == "time" and not written else form.format(named[one], unit[one]) for one in order]
    lines = [delimiter.join(cells[one][at] for one in order) for at in range(len(t))]
    if kind == "falling":
        lines.reverse()
    if kind == "lost":
        kept = np.sort(rng.choice(len(t), 380, replace=False))
        lines, true = [lines[at] for at in kept], {one: values[kept] for one, values in true.items()}
    second = (
        [delimiter.join("" if one == "time" and not written else f"({unit[one]})" for one in order)]
        if style == "row"
        else []
    )
    columns = {
        one: Column(named[one], unit[one] if style == "option" and (one != "time" or written) else None) for one in true
    }
    words = f"{seed}: {kind}, {style}, {named}, {unit}"
    if rng.random() < 0.05:
        columns["torque"], true = Column(named["dtheta"], "N*m"), {}
    return Drawn("\n".join([above + delimiter.join(heads), *second, *lines, ""]), columns, true, words)


def _stamps(rng: np.random.Generator, kind: str, t: Array, unit: dict[str, str]) -> tuple[list[str], bool]:
    """Return the cells of the times, and whether they are numbers in the drawn unit."""
    if kind == "date":
        return [f"2024-05-01 10:00:{one:06.3f}" for one in t], False
    factor = units.factor("time", unit["time"])
    if kind == "whole":
        unit["time"] = "s"
        return [f"{math.floor(one)}" for one in t], True
    if kind == "jitter":
        t += rng.uniform(0.0, 0.3 / RATE, len(t))
    if kind == "wrapped":
        unit["time"] = "ms"
        return [f"{(1e3 * one + 31_500.0) % 32_768.0:.3f}" for one in t], True
    return [f"{one / factor:.9f}" for one in t], True


def judged(drawn: Drawn, path: Path) -> str:
    """Return "right", "refused" or "wrong" for the import of a drawn table. path: of the file to write."""
    path.write_text(drawn.text, encoding="utf-8")
    try:
        channels = understand(path, drawn.columns)[2].channels
    except WrongUse:
        return "refused"
    if not drawn.true or len(channels["time"]) != len(drawn.true["time"]):
        return "wrong"
    scale = {"time": 0.02, "torque": 1e-6, "dtheta": 1e-6}  # whole seconds are spread
    close = [
        np.abs(channels[one] - channels[one][0] - values + values[0]).max() < scale[one]
        for one, values in drawn.true.items()
    ]
    return "right" if all(close) else "wrong"


def main() -> int:
    """Import tables drawn at random; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=50_000)
    counts = {"right": 0, "refused": 0, "wrong": 0}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(parser.parse_args().count):
            drawn = draw(seed)
            counts[found := judged(drawn, Path(folder) / "drawn.csv")] += 1
            if found == "wrong":
                print(drawn.words)
    print(", ".join(f"{name} {count}" for name, count in counts.items()))
    return int(counts["wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main())
