"""Each format gives the same numbers, by names that can be typed; what is not read is named with its conversion."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from hil.errors import WrongUse
from hil.exchange.columns import open_table
from hil.exchange.importer import Column, import_table
from hil.exchange.row_filter import RowFilter

TIME = np.arange(40) / 250.0
TAU, ANGLE = 0.1 * np.sin(30.0 * TIME), 0.2 * np.cos(30.0 * TIME)
BOTH = np.column_stack([TAU, ANGLE])
STAMPS = np.datetime64("2024-05-01T12:00:00") + np.round(TIME * 1e6).astype("m8[us]")
STARTED = 1_714_564_800.0  # s since 1970, of these stamps
SHEETS = "http://schemas.openxmlformats.org/"


def read(path: Path, *names: str, where: str | None = None, topic: str | None = None) -> Any:
    filters = [] if where is None else [RowFilter.parse(where)]
    return open_table(path, topic=topic).read(names, filters)[0]


def mat_v7(path: Path) -> None:
    signals = np.zeros((1, 2), dtype=[("values", "O"), ("label", "O")])
    signals["values"][0] = [TAU[:, None], BOTH]
    signals["label"][0] = ["tau", "both"]
    cells = np.array([BOTH.T, "a"], dtype=object)
    savemat(path, {"M": BOTH, "R": BOTH.T, "out": {"time": TIME, "signals": signals}, "c": cells, "note": "of May"})


def mat_v73(path: Path) -> None:
    def put(name: str, values: Any, kind: bytes) -> Any:
        file[name] = values
        file[name].attrs["MATLAB_class"] = np.bytes_(kind)
        return file[name].ref

    with h5py.File(path, "w", userblock_size=512) as file:
        put("M", BOTH.T, b"double")
        put("out/time", TIME[None, :], b"double")
        refs = [put("#refs#/a", TAU[None, :], b"double"), put("#refs#/b", BOTH.T, b"double")]
        file.create_dataset("out/signals/values", data=np.array(refs, dtype=h5py.ref_dtype)[:, None])
        put("ts", np.zeros((1, 6), "u4"), b"timeseries")
    data = path.read_bytes()
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + data[512:])


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["run/time"], file["run/both"] = TIME, BOTH
        file["sim/names"], file["sim/qpos"] = ["finger", "thumb"], BOTH
        file["run/both"].attrs["units"] = "mN*m"
        file["table"] = np.array(list(zip(TAU, BOTH, strict=True)), dtype=[("tau", "f8"), ("v", "f8", (2,))])
        file["packed"] = np.array([0, 100, -1] + 37 * [5], dtype="i2")
        file["packed"].attrs.update({"scale_factor": 0.1, "add_offset": 1.0, "_FillValue": np.int16(-1)})


def parquet(path: Path) -> None:
    arrow, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    field = arrow.field("tau", arrow.float64(), metadata={"unit": "N*m"})
    wrench = [{"torque": {"z": one}} for one in TAU.tolist()]
    columns = [STAMPS, TAU, BOTH.tolist(), wrench, ["a", "b"] * 20]
    schema = arrow.schema([("stamp", arrow.timestamp("us")), field, ("v", arrow.list_(arrow.float64()))])
    names = ["stamp", "tau", "v", "w", "mode"]
    table = arrow.table(columns, names=names)
    pq.write_table(
        table.set_column(0, "stamp", table["stamp"].cast(schema[0].type)).set_column(1, field, table["tau"]), path
    )


def tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms", reason="TDMS NOT TESTED: npTDMS is missing, pip install '.[test]'")
    clock = {"wf_increment": 0.004, "wf_start_offset": 0.0}
    starts = [STAMPS[0], STAMPS[0], STAMPS[0] + np.timedelta64(1, "s")]
    made = [("bench", "tau", TAU, "N*m"), ("bench", "angle", ANGLE, ""), ("late", "tau", TAU, "")]
    with nptdms.TdmsWriter(path) as writer:
        for (group, name, values, unit), start in zip(made, starts, strict=True):
            properties = clock | {"unit_string": unit, "wf_start_time": start}
            writer.write_segment([nptdms.ChannelObject(group, name, values, properties=properties)])


def json_lines(path: Path) -> None:
    rows = [
        {"at": str(stamp), "joint": {"tau": tau, "v": both}, "mode": "ab"[k % 2]}
        for k, (stamp, tau, both) in enumerate(zip(STAMPS, TAU.tolist(), BOTH.tolist(), strict=True))
    ]
    path.write_text("\n".join(map(json.dumps, rows)) + '\n{"at": "2024-05-01T12:')  # the power was lost


def named_lines(path: Path) -> None:
    orders = (["finger", "thumb"], ["thumb", "finger"])
    own = dict(zip(orders[0], BOTH.T.tolist(), strict=True))
    rows = [
        {"name": orders[k % 2], "effort": [own[one][k] for one in orders[k % 2]], "motors": [{"id": 3, "q": k}]}
        for k in range(len(TIME))
    ]
    path.write_text("\n".join(map(json.dumps, rows)))


def named_parquet(path: Path) -> None:
    arrow, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    named_lines(path)
    pq.write_table(arrow.Table.from_pylist([json.loads(line) for line in path.read_text().splitlines()]), path)


def numpys(path: Path) -> None:
    np.savez(path, t=TIME, both=BOTH, names=["finger", "thumb", "wrist"], q=np.column_stack([BOTH, TIME]))


def json_document(path: Path) -> None:
    path.write_text(json.dumps({"t": TIME.tolist(), "log": {"v": BOTH.tolist()}}))


SIGNALS = {"out.time": TIME, "out.signals(1).values": TAU, "out.signals(2).values(:,2)": ANGLE, "M(:,2)": ANGLE}
NAMED = {"effort.finger": TAU, "effort.thumb": ANGLE, "motors.3.q": np.arange(40.0)}
UNPACKED = np.array([1.0, 11.0, np.nan] + 37 * [1.5])
WRITERS: Mapping[str, tuple[Callable[[Path], None], Mapping[str, Any]]] = {
    "named.jsonl": (named_lines, NAMED),
    "named.parquet": (named_parquet, NAMED),
    "v7.mat": (mat_v7, SIGNALS | {"R(1,:)": TAU, "c{1}(2,:)": ANGLE}),
    "v73.mat": (mat_v73, SIGNALS),
    "v4.mat": (lambda path: savemat(path, {"M": BOTH}, format="4"), {"M(:,1)": TAU}),
    "a.h5": (
        hdf5,
        {
            "run/time": TIME,
            "run/both[:,1] [mN*m]": ANGLE,
            "table.v[:,1]": ANGLE,
            "packed": UNPACKED,
            "sim/qpos.thumb": ANGLE,
        },
    ),
    "a.parquet": (parquet, {"stamp [s]": STARTED + TIME, "tau [N*m]": TAU, "v[1]": ANGLE, "w.torque.z": TAU}),
    "a.tdms": (tdms, {"bench/time [s]": TIME, "bench/tau [N*m]": TAU, "late/time [s]": 1.0 + TIME}),
    "a.npz": (numpys, {"t": TIME, "both[:,1]": ANGLE, "q.thumb": ANGLE}),
    "a.npy": (lambda path: np.save(path, BOTH.T), {"data[1,:]": ANGLE}),
    "a.jsonl": (json_lines, {"at [s]": STARTED + TIME, "joint.tau": TAU, "joint.v[1]": ANGLE}),
    "a.json": (json_document, {"t": TIME, "log.v[1]": ANGLE}),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    for name, (write, _) in WRITERS.items():
        write(folder / name)
    return folder


@pytest.mark.parametrize("name", WRITERS)
def test_every_column_of_a_format_has_a_name_that_can_be_typed(files: Path, name: str) -> None:
    expected = WRITERS[name][1]
    table = open_table(files / name)
    assert set(expected) <= {*table.titles, *(title.split(" [")[0] for title in table.titles)}
    np.testing.assert_allclose(table.read(list(expected), [])[0], list(expected.values()), atol=1e-6)


def test_the_index_of_a_column_is_no_unit_and_one_too_high_is_no_column(files: Path, tmp_path: Path) -> None:
    columns = {"time": Column("t", "s"), "torque": Column("both[:,0]"), "dtheta": Column("both[:,1]", "rad")}
    with pytest.raises(WrongUse, match=r"does not say the unit of 'both\[:,0\]'"):
        import_table(files / "a.npz", tmp_path / "a.h5", columns, [])
    with pytest.raises(WrongUse, match=r"has no column 'both\[:,7\]'; .*it has t, both\[:,0\], both\[:,1\]"):
        import_table(files / "a.npz", tmp_path / "a.h5", columns | {"torque": Column("both[:,7]", "N*m")}, [])


@pytest.mark.parametrize(("name", "column"), [("a.parquet", "tau"), ("a.jsonl", "joint.tau")])
def test_rows_are_chosen_by_text_and_by_time_of_day_in_other_formats_too(files: Path, name: str, column: str) -> None:
    stamp = "stamp" if name == "a.parquet" else "at"
    np.testing.assert_allclose(read(files / name, column, where="mode == 'b'")[0], TAU[1::2])
    np.testing.assert_allclose(read(files / name, column, where="mode!=b")[0], TAU[::2])
    np.testing.assert_allclose(read(files / name, column, where=f"{stamp}>=12:00:00.1")[0], TAU[25:])
    np.testing.assert_allclose(read(files / name, column, where=f"{stamp}<2024-05-01 12:00:00.1")[0], TAU[:25])


def test_an_object_of_matlab_and_a_pickle_are_refused_with_what_to_save_in_their_place(files: Path) -> None:
    with pytest.raises(WrongUse, match=r"'ts' is an object of MATLAB's class timeseries, .* tau = x\.Data; save"):
        read(files / "v73.mat", "ts")
    np.savez(files / "o.npz", t=TIME, q=np.array([{}, 1], dtype=object))
    with pytest.raises(WrongUse, match="holds Python's objects, whose loading can run any program"):
        open_table(files / "o.npz")


@pytest.mark.usefixtures("damaged_files")
@pytest.mark.parametrize("name", ["v7.mat", "v73.mat", "a.parquet", "a.tdms", "a.npz"])
def test_a_damaged_file_is_read_or_refused_and_nothing_else(files: Path, tmp_path: Path, name: str) -> None:
    whole, rng = (files / name).read_bytes(), np.random.default_rng(3)
    for length in (len(whole) // 2, len(whole), len(whole), len(whole)):
        data = bytearray(whole[:length])
        for at in rng.integers(0, length, 8 if length == len(whole) else 0):
            data[at] = rng.integers(256)
        (tmp_path / name).write_bytes(data)
        try:
            read(tmp_path / name, *list(WRITERS[name][1])[:2])
        except WrongUse as refused:
            assert name in str(refused)  # noqa: PT017 - either outcome is right


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.wpilog", b"WPILOG\0\1", "a WPILib log, .* AdvantageScope"),
        ("a.bin", b"MDF     4.10", "an MDF file, .* asammdf"),
        ("a.ulg", b"ULog\x01\x12\x35", "a ULog of PX4, .* ulog2csv"),
        ("a.log", b"(1436509052.249713) can0 044#2A366C2BBA\n", "a log of CAN frames, .* DBC"),
        ("a.pkl", b"\x80\x04\x95", "a pickle of Python, .* never"),
        ("a.csv", b"version https://git-lfs.github.com/spec/v1\noid", "Git LFS .* git lfs pull"),
        ("a.csv", b"PK\x03\x04....", "an archive, .* unpack it"),
    ],
)  # fmt: skip
def test_a_file_that_is_not_read_is_named_as_what_it_is_with_its_conversion(
    tmp_path: Path, name: str, data: bytes, said: str
) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(WrongUse, match=said):
        open_table(tmp_path / name)


# --- workbooks -------------------------------------------------------------------------------------------------------


def workbook(path: Path, merged: str = "", more: str = "", **sheets: list[list[Any]]) -> Path:
    """Write a workbook of texts, numbers and, as "<f>...", cells in XML."""
    pytest.importorskip("python_calamine", reason="XLSX NOT TESTED: python-calamine is missing, pip install '.[test]'")

    def cell(place: str, value: Any) -> str:
        if isinstance(value, str) and not value.startswith("<"):
            return f'<c r="{place}" t="inlineStr"><is><t>{value}</t></is></c>'
        return f'<c r="{place}">{value if isinstance(value, str) else f"<v>{value}</v>"}</c>'

    def link(number: int, kind: str, target: str) -> str:
        return (
            f'<Relationship Id="r{number}" Type="{SHEETS}officeDocument/2006/relationships/{kind}" Target="{target}"/>'
        )

    main, package = f'xmlns="{SHEETS}spreadsheetml/2006/main"', f'xmlns="{SHEETS}package/2006/relationships"'
    names = "".join(f'<sheet name="{name}" sheetId="{k}" r:id="r{k}"/>' for k, name in enumerate(sheets, 1))
    links = "".join(link(k, "worksheet", f"worksheets/sheet{k}.xml") for k in range(1, len(sheets) + 1))
    parts = {
        "_rels/.rels": f"<Relationships {package}>{link(1, 'officeDocument', 'xl/workbook.xml')}</Relationships>",
        "xl/workbook.xml": f'<workbook {main} xmlns:r="{SHEETS}officeDocument/2006/relationships">'
        f"<sheets>{names}</sheets>{more}</workbook>",
        "xl/_rels/workbook.xml.rels": f"<Relationships {package}>{links}</Relationships>",
    }
    for k, rows in enumerate(sheets.values(), 1):
        lines = [
            "".join(
                cell(f"{column}{at}", value) for column, value in zip("ABCD", row, strict=False) if value is not None
            )
            for at, row in enumerate(rows, 1)
        ]
        body = "".join(f'<row r="{at}">{line}</row>' for at, line in enumerate(lines, 1))
        cells = "".join(f'<mergeCell ref="{one}"/>' for one in merged.split())
        parts[f"xl/worksheets/sheet{k}.xml"] = (
            f"<worksheet {main}><sheetData>{body}</sheetData><mergeCells>{cells}</mergeCells></worksheet>"
        )
    with zipfile.ZipFile(path, "w") as packed:
        for name, text in parts.items():
            packed.writestr(name, text)
    return path


HEAD = ["t [s]", "tau [N*m]", "q [rad]"]
ROWS = [[0.0, 0.1, 0.5], [0.1, 0.2, 0.6], [0.2, 0.3, 0.7]]


def test_a_sheet_is_read_below_merged_headings_and_a_line_of_units(tmp_path: Path) -> None:
    top: list[list[Any]] = [["Bench, left"], ["time", "Motor, both"], [None, "tau, cell", "angle"], ["s", "N*m", "rad"]]
    path = workbook(tmp_path / "a.xlsx", "A1:C1 B2:C2 A2:A3", S=[*top, *ROWS], empty=[])
    assert open_table(path).titles == ["time [s]", "tau, cell [N*m]", "angle [rad]"]
    np.testing.assert_array_equal(read(path, "time", "angle"), [[0.0, 0.1, 0.2], [0.5, 0.6, 0.7]])


def test_the_sheet_is_named_where_a_workbook_has_several(tmp_path: Path) -> None:
    path = workbook(tmp_path / "a.xlsx", S=[HEAD, *ROWS], T=[["x", "y"], [1, 2]])
    with pytest.raises(WrongUse, match="name the sheet with --topic; it has S, T"):
        open_table(path)
    np.testing.assert_array_equal(read(path, "tau", topic="S"), [[0.1, 0.2, 0.3]])
    with pytest.raises(WrongUse, match="has no column 'tau'; it has x, y"):
        read(path, "tau", topic="T")


def test_formulas_are_read_by_their_results_and_refused_without_them(tmp_path: Path) -> None:
    with_result = "<f>A2*2</f><v>0.7</v>"
    path = workbook(tmp_path / "a.xlsx", S=[HEAD, *ROWS[:2], [0.2, with_result, 0.7]])
    np.testing.assert_array_equal(read(path, "tau"), [[0.1, 0.2, 0.7]])
    later = '<calcPr fullCalcOnLoad="1"/>'  # the results are zeros
    for more, formula in (("", "<f>A2*2</f>"), ("", "<f>A2*2</f><v></v>"), (later, "<f>A2*2</f><v>0</v>")):
        path = workbook(tmp_path / "a.xlsx", more=more, S=[HEAD, *ROWS[:2], [0.2, formula, 0.7]])
        with pytest.raises(WrongUse, match="has formulas without their results"):
            open_table(path)


def test_a_number_in_merged_cells_is_refused(tmp_path: Path) -> None:
    path = workbook(tmp_path / "a.xlsx", "B2:B3", S=[HEAD, *ROWS])
    with pytest.raises(WrongUse, match=r"the number 0\.1 stands in merged cells, rows 2 to 3"):
        open_table(path)


def other_arrow(path: Path) -> None:
    arrow = pytest.importorskip("pyarrow")
    from pyarrow import ipc

    table = arrow.table({"tau": TAU, "q": ANGLE, "stamp": STAMPS.astype(str)})
    with ipc.new_stream(path, table.schema) as stream:
        stream.write_table(table)


def texts_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["tau"], file["q"], file["stamp"] = TAU, ANGLE, STAMPS.astype(str).tolist()


def texts_npz(path: Path) -> None:
    np.savez(path, tau=TAU, q=ANGLE, stamp=STAMPS.astype(str))


def struct_rows(path: Path) -> None:
    rows = np.zeros((1, len(TIME)), dtype=[("t", "O"), ("tau", "O"), ("q", "O")])
    for at, row in enumerate(zip(TIME, TAU, ANGLE, strict=True)):
        rows[0, at] = row
    savemat(path, {"log": rows})


def data_frame(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["run/axis0"], file["run/axis1"] = [b"t", b"n", b"tau", b"q"], np.arange(len(TIME))
        file["run/block0_items"], file["run/block1_items"] = [b"t", b"tau", b"q"], [b"n"]
        file["run/block0_values"] = np.column_stack([TIME, TAU, ANGLE])
        file["run/block1_values"] = np.arange(len(TIME))[:, None]


@pytest.mark.parametrize(
    ("name", "make", "words", "start"),
    [
        ("a.arrows", other_arrow, ("stamp", "tau", "q"), STARTED),
        ("a.arrow", other_arrow, ("stamp", "tau", "q"), STARTED),
        ("a.h5", texts_hdf5, ("stamp", "tau", "q"), STARTED),
        ("a.npz", texts_npz, ("stamp", "tau", "q"), STARTED),
        ("a.mat", struct_rows, ("log.t", "log.tau", "log.q"), 0.0),
        ("a.h5", data_frame, ("run/t", "run/tau", "run/q"), 0.0),
    ],
)
def test_columns_are_found_in_what_programs_make_of_them(
    tmp_path: Path, name: str, make: Callable[[Path], None], words: tuple[str, ...], start: float
) -> None:
    make(tmp_path / name)
    time, tau, angle = read(tmp_path / name, *words)
    np.testing.assert_allclose(time - start, TIME, atol=1e-6)
    np.testing.assert_allclose([tau, angle], [TAU, ANGLE])
    unit = None if start else "s"  # dates state theirs
    columns = {"time": Column(words[0], unit), "torque": Column(words[1], "N*m"), "dtheta": Column(words[2], "rad")}
    assert import_table(tmp_path / name, tmp_path / "b.h5", columns, []).samples == len(TIME)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.csv", "t,q\n" + '0.1,"[0.1, 0.2]"\n' * 9, "holds lists in its cells, such as .0.1, 0.2."),
        ("a.csv", "Time,ID,DLC,Data\n" + "0.1,0x141,8,A1 00 0B 10 00 00 01 02\n" * 9, "log of CAN frames"),
        (
            "a.csv",
            "tau,q\n" + "".join(f"{0.1 * np.sin(k)},{0.1 * np.cos(k)}\n0,0\n" for k in range(90)),
            "0 between other readings.*two programs wrote one log.*--where 'tau!=0'",
        ),
    ],
)
def test_a_log_that_cannot_be_read_is_refused_with_its_cause(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    columns = {"torque": Column("tau", "N*m"), "dtheta": Column("q", "rad")}
    with pytest.raises(WrongUse, match=said):
        import_table(tmp_path / name, tmp_path / "b.h5", columns, [], rate=100.0)


def test_an_hdf5_file_that_was_not_closed_is_named_as_such(tmp_path: Path) -> None:
    texts_hdf5(tmp_path / "a.h5")
    data = (tmp_path / "a.h5").read_bytes()
    (tmp_path / "a.h5").write_bytes(data[: len(data) // 2])
    with pytest.raises(WrongUse, match=r"was not closed by the program that wrote it.*h5clear -s"):
        open_table(tmp_path / "a.h5")
