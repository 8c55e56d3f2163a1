"""Names of files in messages are words of a shell where a message shows a command."""

from __future__ import annotations

import ast
import re
import shlex
from pathlib import Path

import pytest

from hil.errors import WrongUse
from hil.exchange.coupling import of_result
from hil.printable import quoted
from hil.recording.output import check_unfinished
from hil.recording.writer import Header, RecordingWriter


def test_a_command_in_a_message_names_its_file_as_one_word(tmp_path: Path) -> None:
    path = tmp_path / "a $(b); c.h5"
    RecordingWriter(path, Header(profile={}), 9).close()
    with pytest.raises(WrongUse) as refusal:
        check_unfinished(path)
    command = str(refusal.value).split("`")[1]
    assert shlex.split(command) == ["hil", "recover", f"{path}.part"]
    result = tmp_path / "a b.json"
    result.write_text("{}")
    with pytest.raises(WrongUse) as refusal:
        of_result(result)
    assert shlex.split(str(refusal.value).split("`")[1])[-1] == str(result)


def test_a_path_that_looks_like_an_option_stays_a_path() -> None:
    assert [quoted(Path("-f.h5")), quoted("-1")] == ["./-f.h5", "-1"]


TAKING_FILES = "recover|identify|inspect|import|export|view|campaign|doctor|stand|studio|hysteresis"
COMMAND = re.compile(rf"(\bhil ({TAKING_FILES}) ([^`,;:]* )?|. --(stand|model|fixture|output|where|checkpoint) |-o )$")


def unquoted(path: Path) -> list[str]:
    """The values that a message puts into a command as they are; behind a name's ":" stands what was typed."""
    bare = []
    for text in (one for one in ast.walk(ast.parse(path.read_text())) if isinstance(one, ast.JoinedStr)):
        for before, value in zip(text.values, text.values[1:], strict=False):
            if isinstance(before, ast.Constant) and isinstance(value, ast.FormattedValue) and value.format_spec is None:
                shown = ast.unparse(value.value)
                if COMMAND.search(str(before.value)) and not shown.startswith(("quoted(", "_safe(", "shlex.", "'")):
                    bare.append(f"{path.name}: {before.value!r}{{{shown}}}")
    return bare


def test_every_name_in_a_command_of_a_message_is_one_word_of_a_shell() -> None:
    sources = (Path(__file__).parents[2] / "hil").rglob("*.py")
    assert [one for path in sources for one in unquoted(path)] == []
