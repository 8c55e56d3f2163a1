"""The file of --faults: every kind can be planned, and a wrong key is refused with its line."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from hil.errors import WrongUse
from hil.stand.fault_file import load_plan
from sim_backend.fault_plan import KINDS, PlannedFault


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
        ("[[fault]]\nkind = 'drop'\nframe = 1\nduration = 2\n", "duration .* can only be used with at"),
        ("[[fault]]\nkind = 'delay'\nat = 1\nsize = -1\n", "line 1: fault: size -1: give a number from 0 to 60 .s"),
        ("[[fault]]\nkind = 'truncate'\nat = 1\nsize = 2.5\n", "size 2.5: give a whole number from 1 .* .bytes"),
        ("[[fault]]\nkind = 'drop'\nat = 1\nsize = 1\n", "size 1: this kind of fault has no size"),
        ("[fault]\nkind = 'drop'\n", "line 1: fault: .* must be a list"),
        ("fault = [1]\n", "must be a table"),
        ("[[fault\n", "is not TOML"),
        ("a = " + "[" * 5000, "is nested too deeply"),
    ],
)
def test_what_is_wrong_is_said_with_its_line_and_key(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(WrongUse, match=message):
        loaded(tmp_path, text)


def test_a_kind_takes_its_own_default_and_no_size_beyond_its_range() -> None:
    for name, kind in KINDS.items():
        ends = (kind.default, kind.lowest, kind.highest)
        assert [math.isfinite(one) for one in ends] == [bool(kind.size)] * 3, name
        kind.check(kind.default)
        for size in (kind.lowest - 1.0, kind.highest + 1.0, -math.inf, math.inf):
            with pytest.raises(ValueError, match="size"):
                PlannedFault(name, at=1.0, size=size)
