"""Names of files in messages are words of a shell where a message shows a command."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from hil.errors import WrongUse
from hil.exchange.coupling import of_result
from hil.recording.output import check_unfinished


def test_a_command_in_a_message_names_its_file_as_one_word(tmp_path: Path) -> None:
    path = tmp_path / "a $(b); c.h5"
    path.with_name(f"{path.name}.part").write_bytes(b"x")
    with pytest.raises(WrongUse) as refusal:
        check_unfinished(path)
    command = str(refusal.value).split("`")[1]
    assert shlex.split(command) == ["hil", "recover", f"{path}.part"]
    result = tmp_path / "a b.json"
    result.write_text("{}")
    with pytest.raises(WrongUse) as refusal:
        of_result(result)
    assert shlex.split(str(refusal.value).split("`")[1])[-1] == str(result)
