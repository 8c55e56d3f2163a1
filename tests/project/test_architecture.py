"""docs/architecture.md is true: what it names exists, and nothing is left out."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from .source import PACKAGES, texts

PAGE = (Path(__file__).parents[2] / "docs" / "architecture.md").read_text(encoding="utf-8")

ALLOWED = {
    "hil": {"hil", "ga", "drivers", "sim_backend", "numpy", "h5py", "rich", "typer", "click", "pydantic", "matplotlib"}
    | {
        "scipy",
        "pyarrow",
        "jinja2",
        "markupsafe",
        "pint",
        "tomlkit",
        "threadpoolctl",
        "distributed",
        "plotext",
        "rerun",
        "rosbags",
        "nptdms",
        "python_calamine",
    }
    | {"annotated_types", "mcap_ros2", "anyio", "starlette", "uvicorn"},
    "ga": {"ga", "numpy", "numba", "scipy"},
    "drivers": {"drivers", "annotated_types", "can", "canopen", "dynamixel_sdk", "pydantic", "serial"},
    "sim_backend": {
        "sim_backend",
        "drivers.servo",
        "drivers.gate",
        "drivers.clock",
        "drivers.neighbours",
        "drivers.canbus.multicast",
    }
    | {"drivers.tables"}
    | {"ga.compiled", "numpy", "numba", "annotated_types", "can", "canopen"},
}
"""What each package may import, beside Python's own library."""
ENDS_A_COPY = "hil/recording/posix.py"
"""A forked copy must end without the handlers of the process that it was copied from."""


def sub_packages() -> set[str]:
    return {path.removesuffix("/__init__.py").replace("/", ".") for path in texts() if path.endswith("__init__.py")}


def test_every_sub_package_is_named_on_the_page_of_the_architecture() -> None:
    assert sub_packages() - set(re.findall(r"`([a-z_0-9.]+)`", PAGE)) == set()


def test_every_package_and_file_that_the_page_names_exists() -> None:
    named = {name for pair in re.findall(r"`([a-z_0-9.]+)`|\[\"([a-z_0-9.]+)<br>", PAGE) for name in pair if name}
    assert {name for name in named if "." in name and name.split(".")[0] in PACKAGES} - sub_packages() == set()
    files = re.findall(r"`((?:hil|ga|drivers|sim_backend)/[a-z_0-9/]+\.py)`", PAGE)
    assert len(files) >= 11
    assert set(files) - set(texts()) == set()


IMPORT = re.compile(r"^ *(?:from ([\w.]+) import (\([^)]*\)|.*)|import ([\w.]+))", re.MULTILINE)


def test_no_module_imports_the_private_names_of_another() -> None:
    names = {path: " ".join(found[2] or "" for found in IMPORT.finditer(text)) for path, text in texts().items()}
    assert {path: text for path, text in names.items() if re.search(r"(?<! as )\b_[^_]", text)} == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_what_its_layer_allows(package: str) -> None:
    allowed = ALLOWED[package] | set(sys.stdlib_module_names)
    wrong = {
        f"{path}: {name}"
        for path, text in texts().items()
        if path.startswith(f"{package}/")
        for name in (found[1] or found[3] for found in IMPORT.finditer(text))
        if not any(name == item or name.startswith(f"{item}.") for item in allowed)
    }
    assert wrong == set()


def test_only_the_command_line_prints_or_exits() -> None:
    code = {path: re.sub(r'"""[\s\S]*?"""', "", text) for path, text in texts().items()}
    loud = {path for path, text in code.items() if re.search(r"\b(?:print|exit|quit)\(|\._?exit\b", text)}
    assert {path for path in loud if "/cli/" not in path} == {ENDS_A_COPY}


LOADING = """
import contextlib, io, sys
before = set(sys.modules)
import hil
loaded = set(sys.modules) - before
assert {name.partition(".")[0] for name in loaded} - set(sys.stdlib_module_names) == {"hil"}, loaded
assert len(loaded) < 50, loaded

def none_of(*names):
    assert not set(names) & set(sys.modules), set(names) & set(sys.modules)

from hil.cli.app import main
sys.argv = ["hil", "--help"]
with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()) as said:
    main()
assert "identify" in said.getvalue()
none_of("numpy", "h5py", "numba", "scipy", "pydantic", "matplotlib", "can", "serial", "rich.console")
from hil.stand.file import SIMULATED, parse
parse(SIMULATED)
none_of("dynamixel_sdk", "serial", "can", "canopen", "drivers.dynamixel.config")
import hil.exchange.importer
none_of("pint")  # where nobody writes a unit
import hil.api.analysis
none_of("scipy.optimize", "scipy.signal", "scipy.stats", "scipy.ndimage")  # a tenth of a short run
"""


def test_each_step_loads_only_what_it_needs() -> None:
    """Start-up is part of speed; an absolute time would be the machine's, so the modules are counted."""
    subprocess.run([sys.executable, "-c", LOADING], check=True)
