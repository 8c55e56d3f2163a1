"""The layers of the design: who may import whom, and that only the command line prints or exits."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGES = ("hil", "ga", "drivers", "sim_backend")
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
    }
    | {"annotated_types", "mcap_ros2"},
    "ga": {"ga", "numpy", "numba", "scipy"},
    "drivers": {"drivers", "annotated_types", "can", "canopen", "dynamixel_sdk", "pydantic", "serial"},
    "sim_backend": {"sim_backend", "drivers.servo", "drivers.gate", "drivers.clock", "drivers.canbus.multicast"}
    | {"drivers.tables"}
    | {"ga.compiled", "numpy", "numba", "annotated_types", "can", "canopen"},
}


ENDS_A_COPY = "posix.py"
"""A forked copy must end without the handlers of the process that it was copied from."""


def folder(package: str) -> Path:
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def modules(package: str) -> list[Path]:
    return sorted(folder(package).rglob("*.py"))


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_what_its_layer_allows(package: str) -> None:
    allowed = ALLOWED[package] | set(sys.stdlib_module_names)
    wrong = {
        f"{path.name}: {name}"
        for path in modules(package)
        for name in imports(path)
        if not any(name == item or name.startswith(f"{item}.") for item in allowed)
    }
    assert wrong == set()


def test_only_the_command_line_prints_or_exits() -> None:
    names = {"print", "exit", "quit"}
    wrong = set()
    for package in PACKAGES:
        for path in modules(package):
            if "cli" in path.parts:
                continue
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in names:
                    wrong.add(f"{path.name}:{node.lineno}")
                if isinstance(node, ast.Attribute) and node.attr in {"exit", "_exit"} and path.name != ENDS_A_COPY:
                    wrong.add(f"{path.name}:{node.lineno}")
    assert wrong == set()


def test_asking_for_help_loads_nothing_heavy() -> None:
    """Start-up is part of speed; an absolute time would be the machine's, so the modules are counted."""
    code = (
        "import sys\n"
        "sys.argv = ['hil', '--help']\n"
        "from hil.cli.app import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'h5py', 'numba', 'scipy', 'pydantic', 'matplotlib', 'can', 'serial', 'rich.console'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stderr.strip() == "[]"
    assert "identify" in run.stdout


def test_identifying_loads_none_of_the_slow_parts_of_scipy() -> None:
    """They take a tenth of a short run; what needs one imports it where it is needed."""
    code = (
        "import sys, hil.api.analysis\n"
        "print([name for name in ('optimize', 'signal', 'stats', 'ndimage') if f'scipy.{name}' in sys.modules])\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
