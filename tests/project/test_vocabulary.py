"""One word for one thing: words that the glossary replaces are not used, but for the exceptions listed here."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("hil", "ga", "drivers", "sim_backend", "tests", "benchmarks", "docs")
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
    r"\bBc \?": "Bc (not identifiable)",
    r'"""(What is to be|The same with)': "Return the ...",
}
EXCEPTIONS = {
    ("tests/project/test_vocabulary.py", ""),
    ("hil/report/identification.py", "ladder"),  # reads the JSON of version 1
    ("tests/hil/report/test_identification.py", "ladder"),
    ("docs/decisions/0009-identification-json.md", "ladder"),  # names the words of version 1
    ("tests/hil/recording/test_reader.py", "--soft"),  # the option with which that version wrote the file
}


def texts() -> list[tuple[str, str]]:
    pages = [path for folder in FOLDERS for ending in ("py", "md") for path in (ROOT / folder).rglob(f"*.{ending}")]
    pages += [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    return [(str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")) for path in sorted(pages)]


@pytest.mark.parametrize("pattern", REPLACED)
def test_a_word_that_was_replaced_is_not_used_again(pattern: str) -> None:
    used = [
        f"{name}:{text.count(chr(10), 0, found.start()) + 1}: {found[0].strip()}: {REPLACED[pattern]}"
        for name, text in texts()
        for found in re.finditer(pattern, text, re.IGNORECASE)
        if not {(name, ""), (name, found[0].strip())} & EXCEPTIONS
    ]
    assert used == []
