"""Files of every kind that a person may name by mistake, recordings that no bench makes, and tables drawn at random.

Run it as `python benchmarks/odd_files.py --count 50000`: each drawn table is imported, and must be read right or
refused. The rows count by kind the tables that were read right, refused, and read wrong; with one read wrong the exit
status is 1.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
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
_FOUND = ("right", "refused", "wrong")

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
    """A table drawn at random. data: the bytes of the file. columns: what is asked of it. true: the channels in SI,
    (n,) each; {}: it must be refused. kinds: what was drawn. words: the same, with the names.
    """

    data: bytes
    columns: dict[str, Column]
    true: dict[str, Array]
    kinds: tuple[str, ...]
    words: str


_NAMES = {
    "time": "t,time,Time,timestamp,stamp,clock,Zeit,elapsed time,x-axis,t_rel,sample time,frame,uptime",
    "torque": "tau,torque,Moment,cell,load cell,effort,Drehmoment,M-arm,1,CH1,tau.z,joint torque,arm/tau,F1 (arm)",
    "dtheta": "q,angle,joint rotation,position,pos,theta,2,CH2,Winkel,joint/angle,rev count,q[2],phi-rel,\u03b8",
    "": "current,num cycles,temperature,mode,a,min,rotation speed,in,rev,cell 2,note,cmd,3,motor angle,t2,torque cmd,s",
}
_UNITS = {
    "time": "s,ms,us,sec,milliseconds,min,ns,seconds,h",
    "torque": "N*m,Nm,mN m,mNm,N cm,kgf*cm,oz-in,lbf*in,Nmm,N\u00b7m,uNm,gf cm",
    "dtheta": "rad,deg,degrees,mrad,rev,\u00b0,turns,arcmin",
    "": "A,V,degC,counts,%,rpm,rad/s,mrad,ms,-",
}
_DIMENSION = {"time": "time", "torque": "torque", "dtheta": "angle"}
_STYLES = ("{0} [{1}]", "{0} ({1})", "{0}/{1}", "{0}_{1}", "{0} in {1}", "{0}, {1}", "{0}", "row", "[row]", "option")
_ABOVE = (
    "",
    "# log of rig 7\n",
    "Model{0}DL850\nDate{0}2024/05/01\nRecord Length{0}4000\n",
    "a run of 3 s at 200 Hz\n\n",
    "sep={0}\n",
    "Gain{0}2\nOffset{0}0{1}5\n\n",
    "% 1{0}2{0}3\n",
)
_STAMPS = "even,jitter,falling,whole,wrapped,date,lost,epoch,midnight,shuffled,doubled,days,counter,ISO"
_WRITTEN = "plain,exponents,fixed,thousands,quoted,gaps,trailing,spaced"
_CLOCKS = {"date": "2024-05-01 {:%H:%M:%S.%f}", "midnight": "{:%H:%M:%S.%f}", "ISO": "2024-05-01T{:%H:%M:%S.%f}Z"}


def draw(seed: int) -> Drawn:
    """Return a table of a chirp with headings, units, stamps and numbers written at random."""
    rng = np.random.default_rng(seed)

    def pick(choices: str | Sequence[str]) -> str:
        known = choices.split(",") if isinstance(choices, str) else choices
        return known[int(rng.integers(len(known)))]

    t = np.arange(400) / RATE + rng.uniform(0.0, 5.0)
    phase = 2.0 * np.pi * (t - t[0]) * (0.7 + 2.0 * (t - t[0]))
    true = {"time": t, "torque": 0.3 * np.sin(phase + 0.2), "dtheta": 0.2 * np.sin(phase)}
    stamped, style, written, mark = pick(_STAMPS), pick(_STYLES), pick(_WRITTEN), pick((".", ".", ","))
    delimiter = pick(("\t", ";", "|", " ", *(",," if mark == "." else "")))
    order = [str(one) for one in rng.permutation([*true, *[""] * int(rng.integers(4))])]
    named, unit = [pick(_NAMES[one]) for one in order], [pick(_UNITS[one]) for one in order]
    at = {one: order.index(one) for one in true}
    stamps, unit[at["time"]], rows = _stamps(rng, stamped, t, unit[at["time"]])
    columns = []
    for one, of in zip(order, unit, strict=True):
        factor = units.factor(_DIMENSION[one], of) if one in {"torque", "dtheta"} else 1.0
        texts = [_number(value, written) for value in (true.get(one, rng.normal(size=len(t))) / factor).tolist()]
        if one in {"torque", "dtheta"}:
            true[one] = factor * np.array([float(text.replace(",", "")) for text in texts])
        columns.append(stamps if one == "time" else texts)
    for place in rng.choice(len(t), 9, replace=False) if written == "gaps" else ():
        columns[at["torque"]][place], true["torque"][place] = (
            pick(("NaN", "-", "n/a", *([""] if delimiter != " " else []))),
            math.nan,
        )
    swapped = str.maketrans(".,", ",." if mark == "," else ".,")
    heads = [style.format(name, of) if "{" in style and of else name for name, of in zip(named, unit, strict=True)]
    lines = [heads, *([unit] if style == "row" else [[f"[{of}]" for of in unit]] if style == "[row]" else [])]
    lines += [[column[place].translate(swapped) for column in columns] for place in rows]
    bare = delimiter == " " and rng.random() < 0.5
    last = (delimiter if written == "trailing" else "") + pick(("\n", "\r\n"))
    text = pick(_ABOVE).format(delimiter, mark)
    for line in lines:
        quoted = [f'"{one}"' if written == "quoted" or (delimiter in one and not bare) else one for one in line]
        text += delimiter.join(one.rjust(12) if written == "spaced" else one for one in quoted) + last
    asked = {
        one: Column(named[place], (unit[place] or None) if style == "option" else None) for one, place in at.items()
    }
    wrong = {0: "dtheta", 1: "time", 2: ""}.get(int(rng.integers(40)))
    if wrong is not None and wrong in order:
        asked["torque"] = Column(named[order.index(wrong)], "N*m" if wrong else None)
    true = {} if asked["torque"].name != named[at["torque"]] or stamped == "counter" else true
    true = {one: values[np.unique(rows)] for one, values in true.items()}
    kinds = (f"stamps: {stamped}", f"headings: {style}", f"numbers: {written}", f"decimal {mark} between {delimiter!r}")
    words = f"{seed}: {kinds}, {bare}, {asked}, {[*zip(order, named, unit, strict=True)]}"
    encoding = pick(("utf-8", "utf-8", "utf-8-sig", "utf-16", "cp1252"))
    return Drawn(text.encode(encoding, "replace"), asked, true, kinds, words)


def _number(value: float, written: str) -> str:
    forms = {"exponents": "{:.8e}", "fixed": "{:.4f}", "thousands": "{:,.3f}"}
    return forms.get(written, "{:.9g}").format(value)


def _stamps(rng: np.random.Generator, kind: str, t: Array, unit: str) -> tuple[list[str], str, NDArray[np.int64]]:
    """Return the cells of the times, their unit, "" if they are no numbers, and the rows in the order of the file."""
    rows, count = np.arange(len(t)), len(t)
    if kind in _CLOCKS:
        start = datetime(2024, 5, 1, 23, 59, 55) if kind == "midnight" else datetime(2024, 5, 1, 10)
        return [_CLOCKS[kind].format(start + timedelta(seconds=one)) for one in t.tolist()], "", rows
    other = {
        "counter": ([str(one + 100) for one in rows], ""),
        "whole": ([f"{math.floor(one)}" for one in t], "s"),
        "wrapped": ([f"{(1e3 * one + 31_500.0) % 32_768.0:.3f}" for one in t], "ms"),
        "days": ([f"{45_413.4 + one / 86_400.0:.11f}" for one in t], "d"),
    }
    if kind in other:
        return *other[kind], rows
    if kind == "jitter":
        t += rng.uniform(0.0, 0.3 / RATE, count)
    order = {
        "falling": rows[::-1],
        "lost": np.sort(rng.choice(count, 380, replace=False)),
        "doubled": np.sort([*rows, *rng.choice(count, 40, replace=False)]),
        "shuffled": np.argsort(rows + rng.uniform(0.0, 2.5, count)),
    }
    factor, start = units.factor("time", unit), 1.7e9 if kind == "epoch" else 0.0
    return [f"{one:.9f}" for one in ((start + t) / factor).tolist()], unit, order.get(kind, rows)


def judged(drawn: Drawn, path: Path) -> str:
    """Return "right", "refused" or "wrong" for the import of a drawn table. path: of the file to write."""
    path.write_bytes(drawn.data)
    try:
        channels = understand(path, drawn.columns)[2].channels
    except WrongUse:
        return "refused"
    if not drawn.true or len(channels["time"]) != len(drawn.true["time"]):
        return "wrong"
    late = np.abs(channels["time"] - channels["time"][0] - drawn.true["time"] + drawn.true["time"][0])
    close = [np.allclose(channels[one], drawn.true[one], 1e-9, 0.0, equal_nan=True) for one in ("torque", "dtheta")]
    allowed = 0.02 if "stamps: whole" in drawn.kinds else 1e-5  # s; whole seconds are spread
    return "right" if late.max() < allowed and all(close) else "wrong"


def main() -> int:
    """Import tables drawn at random and print how many of each kind were read right; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=50_000)
    counts = Counter[tuple[str, str]]()
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(parser.parse_args().count):
            drawn = draw(seed)
            found = judged(drawn, Path(folder) / "drawn.csv")
            counts.update((kind, found) for kind in ("all", *drawn.kinds))
            if found == "wrong":
                print(drawn.words, file=sys.stderr)
    write = csv.writer(sys.stdout, lineterminator="\n").writerow
    write(["kind", *_FOUND])
    for kind in sorted({kind for kind, _ in counts}):
        write([kind, *(counts[kind, found] for found in _FOUND)])
    return int(counts["all", "wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main())
