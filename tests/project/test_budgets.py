"""Nothing grows unnoticed. Whoever raises a number of this file gives the reason in the message of the same commit."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from statistics import median, quantiles

import pytest

from .source import Module, modules

ROOT = Path(__file__).parents[2]

WORDS_OF_A_PAGE = {"CHANGELOG.md": 600, "docs/accuracy.md": 1_500}
WORDS_OF_ANY_OTHER_PAGE = 2_500
WORDS = 40_000  # README, CHANGELOG and docs/, without the decisions

MODULES_OF_A_FOLDER = 15
LINES_OF_A_MODULE = 400
LINES_OF_A_FUNCTION, OF_ONE_IN_TEN, OF_HALF = 60, 20, 7

STACK = {  # numbers in statements of a module, other numbers in functions, codes of diagnostics
    "hil/identification": (18, 1, 19),
    "hil/signals": (308, 0, 13),  # one file for both
    "ga/model": (137, 0, 0),
}
CODES = 30


def pages() -> dict[str, int]:
    """The words of each page by its name."""
    paths = [ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md")]
    return {path.relative_to(ROOT).as_posix(): len(path.read_text(encoding="utf-8").split()) for path in paths}


def test_a_page_is_short() -> None:
    budget = {page: WORDS_OF_A_PAGE.get(page, WORDS_OF_ANY_OTHER_PAGE) for page in pages()}
    assert {page: words for page, words in pages().items() if words > budget[page]} == {}


def test_all_pages_together_are_read_in_an_afternoon() -> None:
    assert sum(pages().values()) <= WORDS


def test_a_folder_holds_no_more_modules_than_a_person_can_survey() -> None:
    counts = Counter(path.rpartition("/")[0] for path in modules() if not path.endswith("__init__.py"))
    assert {folder: count for folder, count in counts.items() if count > MODULES_OF_A_FOLDER} == {}


def test_a_module_is_read_in_one_sitting() -> None:
    assert {path: module.lines for path, module in modules().items() if module.lines > LINES_OF_A_MODULE} == {}


def test_functions_are_short() -> None:
    lengths = {
        f"{path}:{name}": lines for path, module in modules().items() for name, lines in module.functions.items()
    }
    assert {name: length for name, length in lengths.items() if length > LINES_OF_A_FUNCTION} == {}
    assert median(lengths.values()) <= OF_HALF
    assert quantiles(lengths.values(), n=10)[-1] <= OF_ONE_IN_TEN


def modules_of(folder: str) -> list[Module]:
    return [module for path, module in modules().items() if path.startswith(f"{folder}/")]


@pytest.mark.parametrize("folder", STACK)
def test_the_identification_gets_no_further_constants_and_codes(folder: str) -> None:
    found = modules_of(folder)
    codes = set().union(*(module.codes for module in found))
    counts = sum(module.named for module in found), sum(module.unnamed for module in found), len(codes)
    assert all(count <= budget for count, budget in zip(counts, STACK[folder], strict=True)), counts


def test_the_numbers_that_decide_stand_in_one_module_of_constants() -> None:
    of_the_paper = "hil/identification/replicate.py"
    found = {path for path, module in modules().items() if module.decides and path.startswith(tuple(STACK))}
    assert {path for path in found if path.startswith("hil/")} <= {"hil/signals/constants.py", of_the_paper}


def test_the_identification_has_no_more_codes_in_all() -> None:
    assert len({code for folder in STACK for module in modules_of(folder) for code in module.codes}) <= CODES
