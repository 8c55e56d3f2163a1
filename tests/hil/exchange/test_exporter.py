"""Recordings into tables and back: nothing may change on the way."""

from __future__ import annotations

import csv
import gzip
import math
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from hil.errors import Untrustworthy, WrongUse
from hil.exchange.exporter import export, format_of
from hil.exchange.importer import import_table
from hil.exchange.row_filter import RowFilter
from hil.recording.channels import CHANNELS, Row
from hil.recording.reader import Recording
from hil.recording.writer import Header, RecordingWriter, write


def recording(tmp_path: Path, rows: int = 300) -> Path:
    """Every channel, with numbers that no short decimal holds, lost replies and NaN among them."""
    rng = np.random.default_rng(4)
    channels = {name: rng.standard_normal(rows) * 10.0 ** rng.integers(-9, 3) for name in CHANNELS if name != "seq"}
    channels["time"] = 5.0 + np.sort(rng.random(rows))
    channels["status"] = rng.integers(0, 31, rows).astype(np.float64)
    channels["torque"][7] = math.nan
    channels["joint_position"][:] = math.nan
    write(tmp_path / "a.h5", Header(profile={"kind": "chirp"}), channels)
    return tmp_path / "a.h5"


def samples(path: Path) -> dict[str, list[str]]:
    with Recording(path) as opened:
        return {name: [value.hex() for value in opened.channel(name).tolist()] for name in CHANNELS}


@pytest.mark.parametrize("name", ["a.csv", "a.parquet", "a.mat", pytest.param("a.mcap", marks=pytest.mark.study)])
def test_what_is_exported_and_imported_again_is_the_same_to_the_last_bit(tmp_path: Path, name: str) -> None:
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow", reason="PARQUET NOT TESTED: pyarrow is missing")
    if name.endswith("mcap"):
        pytest.importorskip("mcap_ros2", reason="MCAP NOT TESTED: mcap-ros2-support is missing")
    source = recording(tmp_path)
    assert export(source, tmp_path / name) == 300
    assert import_table(tmp_path / name, tmp_path / "b.h5", {}, []).samples == 300
    assert samples(tmp_path / "b.h5") == samples(source)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["a.h5", name, "b.h5"])


def test_an_mcap_holds_joint_states_that_its_own_reader_decodes(tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2", reason="MCAP NOT TESTED: mcap-ros2-support is missing")
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    source = recording(tmp_path)
    export(source, tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        states: list[Any] = [found[3] for found in reader.iter_decoded_messages(topics=["/joint_states"])]
    with Recording(source) as opened:
        torque, dtheta = opened.channel("torque"), opened.channel("dtheta")
    assert [state.name for state in states] == [["joint"]] * 300
    np.testing.assert_array_equal([state.effort[0] for state in states], torque)
    np.testing.assert_array_equal([state.position[0] for state in states], dtheta)


def test_a_mat_file_holds_column_vectors_and_units_for_its_own_reader(tmp_path: Path) -> None:
    from scipy.io import loadmat

    source = recording(tmp_path)
    export(source, tmp_path / "a.mat")
    table = loadmat(tmp_path / "a.mat")
    with Recording(source) as opened:
        np.testing.assert_array_equal(table["torque"], opened.channel("torque")[:, None])
    assert table["units"]["torque"][0, 0] == ["N*m"]


@pytest.mark.parametrize(
    ("name", "given", "said"),
    [
        ("a.csv", "parquet", r"a.csv says csv by its name, and --format says parquet: name the output .*a.parquet"),
        ("a.xml", "urdf", "says mujoco by its name"),
        ("a.xlsx", None, r"a.xlsx: the name of an export ends in one of csv \(.csv, .csv.gz\), parquet"),
        ("a", "csv", "the name of --format csv ends in .csv or .csv.gz"),
        ("a.csv", "excel", "unknown --format 'excel': known are csv"),
    ],
)
def test_an_output_that_says_another_format_is_refused(tmp_path: Path, name: str, given: str | None, said: str) -> None:
    with pytest.raises(WrongUse, match=said):
        format_of(tmp_path / name, given)
    assert format_of(tmp_path / "A.CSV", None) == format_of(tmp_path / "a.csv.gz", "csv") == "csv"


def test_headings_carry_the_units_and_nan_is_an_empty_cell(tmp_path: Path) -> None:
    export(recording(tmp_path), tmp_path / "a.csv.gz")
    with gzip.open(tmp_path / "a.csv.gz", "rt", encoding="utf-8", newline="") as text:
        rows = list(csv.DictReader(text))
    assert {"time [s]", "torque [N*m]", "dtheta [rad]", "dtheta_dot [rad/s]", "status [1]"} <= set(rows[0])
    assert rows[7]["torque [N*m]"] == rows[0]["joint_position [rad]"] == ""
    assert rows[7]["seq [1]"] == "7"


def test_a_recording_that_never_ended_is_exported_as_far_as_it_goes(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.h5", Header(profile={"kind": "chirp"}), 100) as part:
        for seq in range(42):
            part.append(Row(seq))
    assert export(tmp_path / "a.h5.part", tmp_path / "a.csv") == 42


def test_a_recording_that_was_changed_is_not_exported(tmp_path: Path) -> None:
    source = recording(tmp_path)
    with h5py.File(source, "r+") as file:
        file.attrs["stand_toml"] = "[stand]\ngear_ratio = 40.0\n"
    with pytest.raises(Untrustworthy, match=r"a\.h5 is not as it was written"):
        export(source, tmp_path / "a.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


@pytest.mark.study
def test_an_export_can_be_imported_in_part(tmp_path: Path) -> None:
    export(recording(tmp_path), tmp_path / "a.csv")
    done = import_table(tmp_path / "a.csv", tmp_path / "b.h5", {}, [RowFilter.parse("seq<100")])
    assert done.samples == 100


def test_a_table_that_is_no_export_must_have_its_columns_named(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time [s],torque [N*m]\n0,1\n")
    with pytest.raises(WrongUse, match=r"name the columns of .* with --time, --torque and --dtheta; it has time"):
        import_table(tmp_path / "a.csv", tmp_path / "b.h5", {}, [])


def test_an_export_that_cannot_be_written_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = recording(tmp_path)
    with pytest.raises(WrongUse, match="name the output so"):
        export(source, tmp_path / "a.xlsx")
    with pytest.raises(WrongUse, match="cannot be written"):
        export(source, tmp_path / "none" / "a.csv")
    for name, package, extra in (("a.parquet", "pyarrow", "parquet"), ("a.mcap", "mcap_ros2.writer", "ros")):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(WrongUse, match=rf"{name}: .* needs .*: pip install 'hil\[{extra}\]'"):
            export(source, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]
