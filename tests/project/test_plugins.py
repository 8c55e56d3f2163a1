"""Drives and models of other packages: the example package is installed and used, a broken one harms nobody."""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ga.model import terms
from hil.plugins import installed

from ..hil.conftest import Hil, hil  # noqa: F401 - a fixture

EXAMPLE = Path(__file__).parents[2] / "examples" / "hil-example-drive"
STAND = """
[stand]
backend = "springdrive"
motor_inertia = 1e-9
[limits]
torque = 0.02
deflection = 1.0
velocity = 200.0
[springdrive]
stiffness = 0.025
damping = 3e-4
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of packages with one whose drive cannot be loaded."""
    place = tmp_path_factory.mktemp("site")
    broken = place / "broken-1.0.dist-info"
    broken.mkdir()
    (broken / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (broken / "entry_points.txt").write_text(
        "[hil.backends]\nbroken = no_such_module:DRIVE\nnothing = os:sep\n[hil.models]\nbent = no_such_module:TERM\n"
    )
    return place


@pytest.fixture(scope="module")
def example(site: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """The example package as pip installs it."""
    source = tmp_path_factory.mktemp("source") / "package"
    source.mkdir()
    for path in [EXAMPLE / "pyproject.toml", *EXAMPLE.glob("hil_example_drive/*.py")]:
        copy = source / path.relative_to(EXAMPLE)
        copy.parent.mkdir(exist_ok=True)
        copy.write_bytes(path.read_bytes())
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target", str(site)]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, str(source)], check=True, capture_output=True)


@pytest.fixture
def packages(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(site)
    importlib.invalidate_caches()
    tables: list[dict[str, Any]] = [terms._terms, terms._parameters]
    before = [dict(table) for table in tables]
    installed.cache_clear()
    yield
    installed.cache_clear()
    for table, kept in zip(tables, before, strict=True):
        table.clear()
        table.update(kept)


@pytest.mark.study
@pytest.mark.usefixtures("example", "packages")
def test_drives_are_listed_with_their_package_and_broken_ones_with_the_reason(hil: Hil) -> None:  # noqa: F811
    lines = {line.split()[0]: line for line in hil("record", "--list-backends").out.splitlines()}
    assert {"sim", "dynamixel", "loadcell"} <= set(lines)
    assert lines["springdrive"].endswith("(hil-example-drive 0.1.0)")
    assert "skipped" in lines["broken"]
    assert "No module named 'no_such_module'" in lines["broken"]
    assert "os:sep is no Device" in lines["nothing"]


@pytest.mark.study
@pytest.mark.usefixtures("example", "packages")
def test_models_are_listed_with_their_package_and_broken_ones_with_the_reason(hil: Hil) -> None:  # noqa: F811
    lines = {line.split()[0]: line for line in hil("identify", "--list-models").out.splitlines()}
    assert {"linear", "skew"} <= set(lines)
    assert all(lines[name].endswith("(hil-example-drive 0.1.0)") for name in ("seventh", "power"))
    assert "skipped" in lines["bent"]


@pytest.mark.study
@pytest.mark.usefixtures("example", "packages")
def test_a_stand_with_the_drive_of_another_package_is_recorded_and_identified_with_its_models(
    hil: Hil,  # noqa: F811
) -> None:
    Path("stand.toml").write_text(STAND)
    assert hil("record", "--stand", "stand.toml", "--duration", 3, "--band", "0.5:5", "-o", "a.h5").status == 0
    found = hil("identify", "a.h5", "--model", "linear+seventh", "--trials", 2, "--json").json["parameters"]
    assert found["Kc"]["value"] == pytest.approx(0.025, rel=2e-3)
    assert found["Bc"]["value"] == pytest.approx(3e-4, rel=0.2)  # the torque is held for a tick
    assert abs(found["K7"]["value"]) < 0.5
    power = hil("identify", "a.h5", "--model", "power", "--trials", 2, "--json").json["parameters"]
    assert power["n"]["value"] == pytest.approx(1.0, abs=0.01)


@pytest.mark.usefixtures("packages")
def test_a_stand_whose_drive_is_broken_is_refused_with_the_package(hil: Hil) -> None:  # noqa: F811
    Path("stand.toml").write_text(STAND.replace("springdrive", "broken"))
    ended = hil("record", "--stand", "stand.toml")
    assert ended.status == 2
    assert "'broken' of the package broken 1.0 cannot be loaded" in ended.err
    assert "Traceback" not in ended.err


@pytest.mark.study
@pytest.mark.usefixtures("example", "packages")
def test_other_stands_do_not_load_other_packages(hil: Hil) -> None:  # noqa: F811
    sys.modules.pop("hil_example_drive", None)
    assert hil("record", "--backend", "sim", "--duration", 0.5, "--fade", 0.1, "-o", "a.h5").status == 0
    assert "hil_example_drive" not in sys.modules
