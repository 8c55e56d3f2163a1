"""The file of --faults: every kind can be planned, and a wrong key is refused with its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.errors import WrongUse
from hil.stand.fault_file import load_plan
from sim_backend.fault_plan import KINDS


def loaded(folder: Path, text: str) -> frozenset[str]:
    (folder / "plan.toml").write_text(text)
    return load_plan(folder / "plan.toml").kinds()


def test_every_kind_can_be_planned(tmp_path: Path) -> None:
    text = "".join(f'[[fault]]\nkind = "{kind}"\nat = 1\n' for kind in KINDS)
    assert loaded(tmp_path, text) == frozenset(KINDS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed = 1\n", "line 1: fault: must be given"),
        ("seeed = 1\n[[fault]]\nkind = 'drop'\nat = 1\n", "line 1: seeed: no such key"),
        ("[[fault]]\nkind = 'drop'\nat = 1\n\n[[fault]]\nat = 1\nkind = 'dorp'\n", "line 7: kind: there is no kind"),
        ("[[fault]]\nkind = 'drop'\nat = 1\ncuont = 2\n", "line 4: cuont: no such key"),
        ("[[fault]]\nkind = 'drop'\nprobability = 1.5\n", "line 3: probability: 1.5 must be at most 1"),
        ("[[fault]]\nkind = 'drop'\nframe = 0\n", "line 3: frame: 0 must be at least 1"),
        ("[[fault]]\nkind = 'drop'\nat = nan\n", "line 3: at: nan must be"),
        ("[[fault]]\nkind = 'drop'\nat = '1'\n", "line 3: at: '1' must be a number"),
        ("# plan\n[[fault]]\nkind = 'drop'\n", "line 2: .*give one of at"),
        ("[[fault]]\nkind = 'drop'\nat = 1\nframe = 2\n", "give one of at"),
        ("[[fault]]\nkind = 'drop'\nframe = 1\nduration = 2\n", "duration .* goes with at"),
        ("[fault]\nkind = 'drop'\n", "line 1: fault: .* must be a list"),
        ("fault = [1]\n", "must be a table"),
        ("[[fault\n", "is not TOML"),
        ("a = " + "[" * 5000, "is not TOML"),
    ],
)
def test_what_is_wrong_is_said_with_its_line_and_key(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(WrongUse, match=message):
        loaded(tmp_path, text)
