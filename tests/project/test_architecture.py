"""docs/architecture.md is true: what it names exists, and nothing is left out; folders and functions stay small."""

from __future__ import annotations

import ast
import re
from importlib.util import find_spec
from pathlib import Path
from statistics import median, quantiles

PAGE = (Path(__file__).parents[2] / "docs" / "architecture.md").read_text(encoding="utf-8")
PACKAGES = ("hil", "ga", "drivers", "sim_backend")
LARGEST_FOLDER, LONGEST_FUNCTION = 15, 60


def root() -> Path:
    """The folder that holds the packages: a checkout, or where they are installed."""
    spec = find_spec("hil")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parents[1]


ROOT = root()


def sub_packages() -> set[str]:
    folders = {path.parent for package in PACKAGES for path in (ROOT / package).rglob("__init__.py")}
    return {".".join(folder.relative_to(ROOT).parts) for folder in folders}


def modules() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def function_lengths() -> dict[str, int]:
    found = {}
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                assert node.end_lineno is not None
                found[f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"] = node.end_lineno - node.lineno + 1
    return found


def test_every_sub_package_is_named_on_the_page_of_the_architecture() -> None:
    named = set(re.findall(r"`([a-z_0-9.]+)`", PAGE))
    assert sub_packages() - named == set()


def test_every_package_that_the_page_names_exists() -> None:
    named = {
        name for name in re.findall(r"`([a-z_0-9.]+)`|\[\"([a-z_0-9.]+)<br>", PAGE) for name in name if "." in name
    }
    dotted = {name for name in named if name.split(".")[0] in PACKAGES}
    assert dotted - sub_packages() == set()


def test_every_file_on_the_way_of_a_sample_exists() -> None:
    files = re.findall(r"`((?:hil|ga|drivers|sim_backend)/[a-z_0-9/]+\.py)`", PAGE)
    assert len(files) >= 11
    assert [name for name in files if not (ROOT / name).is_file()] == []


def test_no_folder_holds_more_modules_than_a_person_can_survey() -> None:
    folders = {path.parent for path in modules()}
    crowded = {
        str(folder): count
        for folder in folders
        if (count := len([path for path in folder.glob("*.py") if path.name != "__init__.py"])) > LARGEST_FOLDER
    }
    assert crowded == {}


def test_functions_are_short() -> None:
    lengths = function_lengths()
    assert {name: length for name, length in lengths.items() if length > LONGEST_FUNCTION} == {}
    assert median(lengths.values()) <= 7
    assert quantiles(lengths.values(), n=10)[-1] <= 20


def test_no_module_imports_the_private_names_of_another() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}: {alias.name}"
        for path in modules()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.name.startswith("_") and not alias.name.startswith("__")
    ]
    assert wrong == []
