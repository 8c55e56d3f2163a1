"""Names that are not known: the nearest is proposed, and all are listed. Names of outputs that are refused."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

import hil
from hil.cli.app import run
from hil.errors import meant, proposing, unknown

from .conftest import Maker


def test_an_unknown_name_has_the_nearest_and_all_that_are_known() -> None:
    assert str(unknown("preset", "PAPR", ["paper", "default"])) == (
        "unknown preset 'PAPR': did you mean 'paper'? known are paper, default"
    )
    assert meant("xyz", ["paper"]) == ""


def test_a_message_that_lists_values_gets_the_nearest_at_its_end() -> None:
    listed = "Invalid value for '--mode': 'torqe' is not one of 'torque', 'position'."
    assert proposing(listed).endswith("'torque', 'position'; did you mean 'torque'?")
    assert proposing("model 'ak70-1' is not known: choose one of ak70-10, ak80-9").endswith("did you mean 'ak70-10'?")
    assert proposing("nothing is listed here") == "nothing is listed here"


@pytest.mark.parametrize(
    ("words", "meant_is"),
    [
        ("record --backend sim --mode torqe", "torque"),
        ("emulate dynamixel --model xl330-m28 --link ./line", "xl330-m288"),
        ("emulate mit --model ak70-1 --link ./line", "ak70-10"),
        ("identify a.h5 --preset papr", "paper"),
        ("identify a.h5 --selection larg --preset paper", "larger"),
        ("identify a.h5 --require kc", "Kc"),
        ("record --backend sim --profile chrip", "chirp"),
    ],
)
def test_every_choice_on_the_command_line_proposes_the_nearest(
    words: str, meant_is: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(words.split()) == 2
    assert f"did you mean '{meant_is}'?" in " ".join(capfd.readouterr().err.split())


@pytest.mark.parametrize("name", ["run.csv", "run.txt", "run.PNG", "run.part", "run.h5.part"])
def test_a_recording_whose_name_says_another_format_is_refused(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert run(["record", "--backend", "sim", "--duration", "0.1", "-o", name]) == 2
    assert f"{name} is no name of a recording, which is HDF5: name it run.h5" in capfd.readouterr().err


@pytest.mark.parametrize("name", ["a\nhil: all is well.h5", "a\x1b[2J.h5", "a\x85.h5"])
def test_an_output_whose_name_would_steer_a_terminal_is_refused(
    name: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run(["record", "--backend", "sim", "--duration", "0.1", "-o", str(tmp_path / name)]) == 2
    assert "control character" in capfd.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "error",
    [OSError(number, os.strerror(number)) for number in (errno.EMFILE, errno.ENOMEM, errno.EAGAIN)]
    + [MemoryError("no room for it"), RuntimeError("can't start new thread")],
    ids=repr,
)
def test_a_computer_that_is_out_of_files_or_memory_is_no_fault_in_hil(
    error: Exception, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.api.runs.record", raising(error))
    assert run(["record", "--backend", "sim"]) == 2
    said = capfd.readouterr().err
    assert (str(error) in said, "ulimit -n" in said, "fault in hil" in said) == (True, True, False)


def raising(error: Exception) -> Callable[..., None]:
    def refused(*_: object, **__: object) -> None:
        raise error

    return refused


def test_a_fault_of_hils_own_has_its_own_exit_status_and_exception(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The caller's own function may raise as well: then the caller gets the error that it raised."""
    fault = ZeroDivisionError("float division by zero")
    with monkeypatch.context() as patch:
        patch.setattr("hil.recording.reader.Recording.__init__", raising(fault))
        assert run(["identify", "a.h5"]) == 70
        assert "fault in hil itself" in capfd.readouterr().err
        with pytest.raises(hil.InternalError, match="fault in hil itself") as raised:
            hil.identify("a.h5")
        assert raised.value.__cause__ is fault
    with pytest.raises(TypeError):
        hil.identify("a.h5", nothing=1)  # type: ignore[call-arg]
    with pytest.raises(hil.WrongUse):
        hil.identify("a.h5")


def test_an_error_of_the_callers_function_is_the_callers(make_recording: Maker) -> None:
    error = ZeroDivisionError("of the caller")
    with pytest.raises(ZeroDivisionError):
        hil.identify(make_recording(samples=400, noise=1e-5), "linear", progress=raising(error))
