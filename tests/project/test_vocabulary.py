"""One word for one thing: words that the glossary replaces are not used, but for the exceptions listed here."""

from __future__ import annotations

import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("hil", "ga", "drivers", "sim_backend")
REPLACED = {
    r"\btold\b|cannot be told|can be told": "identifiable, can be estimated, cannot be distinguished from",
    r"\bladders?\b|\brungs?\b|\bclimb(s|ed|ing)?\b": "model selection; step; included, rejected",
    r"asks for nor|neither asks": "the data cannot decide whether ... is present",
    r"search's own error": "optimiser gap",
    r"held-out fifth": "validation on 20 % held-out data",
    r"\bjudgement|\bsteadiness|\bspool(s|ed)?\b": "identifiability; stationarity; out-of-core table",
    r"\bvalleys?\b|\bcurved\b": "local minimum; separable",
    r"\bstrained\b": "worst case",
    r"\blets? go\b": "unilateral contact; sticking",
    r"lets the cable|let down gently": "ramps the torque to zero",
    r"\bgone on (from|with)\b|goes on with it": "resume",
    r"\bfindings?\b": "warning, error",
    r"(?m)^\s*(note|problem) \[": "warning, error",
    r"--soft\b|--quantity\b|--picture\b": "--fade, --mode, --report",
    r"\bbc \?": "Bc (not identifiable)",
    r'"""(what is to be|the same with)': "Return the ...",
}
EXCEPTIONS = {
    ("tests/project/test_vocabulary.py", ""),
    ("hil/report/identification_json.py", "ladder"),  # reads the JSON of version 1
    ("tests/hil/report/test_identification_json.py", "ladder"),
    ("docs/decisions/0009-identification-json.md", "ladder"),  # names the words of version 1
    ("tests/hil/recording/test_reader.py", "--soft"),  # the option with which that version wrote the file
}


@cache
def texts() -> list[tuple[str, str]]:
    """Every module and page by its name, in lower case: the packages from where they are installed, the
    rest from beside the tests.
    """
    spec = find_spec("hil")
    assert spec is not None
    assert spec.origin is not None
    installed = Path(spec.origin).parents[1]
    places = [(installed, name) for name in PACKAGES] + [(ROOT, name) for name in ("tests", "benchmarks", "docs")]
    found = [
        (root, path) for root, name in places for ending in ("py", "md") for path in (root / name).rglob(f"*.{ending}")
    ]
    found += [(ROOT, ROOT / "README.md"), (ROOT, ROOT / "CONTRIBUTING.md")]
    assert len(found) > 400
    return [(str(path.relative_to(root)), path.read_text(encoding="utf-8").lower()) for root, path in sorted(found)]


@pytest.mark.parametrize("pattern", REPLACED)
def test_a_word_that_was_replaced_is_not_used_again(pattern: str) -> None:
    used = [
        f"{name}:{text.count(chr(10), 0, found.start()) + 1}: {found[0].strip()}: {REPLACED[pattern]}"
        for name, text in texts()
        for found in re.finditer(pattern, text)
        if not {(name, ""), (name, found[0].strip())} & EXCEPTIONS
    ]
    assert used == []
