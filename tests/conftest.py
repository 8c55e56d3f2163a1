"""What every test is held to: no thread and no child process may outlive it."""

from __future__ import annotations

import functools
import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

# before numpy is imported: every core has a worker of its own, and more threads only wait for each other
os.environ.setdefault("OMP_NUM_THREADS", "1")

# where Python is asked to leave no bytecode, every worker and program that a test starts would compile all sources
if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
    sys.dont_write_bytecode = False
    sys.pycache_prefix = str(Path(__file__).parent.parent / ".pytest_cache" / "bytecode")
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix

import pytest
from hypothesis import settings

from hil.recording import writer
from hil.recording.posix import in_child

from .budget import (  # noqa: F401 - hooks
    pytest_runtest_logreport,
    pytest_runtest_makereport,
    pytest_runtest_setup,
    pytest_sessionfinish,
    pytest_terminal_summary,
)
from .late_ticks import ALLOWED

settings.register_profile("hil", deadline=None, max_examples=40)  # a busy computer makes no example wrong
settings.load_profile("hil")

SOFTWARE = functools.cache(writer._software)
UNSEARCHED = SimpleNamespace(collect=int, freeze=gc.freeze, unfreeze=gc.unfreeze)
IN_TURN = ("tests/hil/studio/test_browser.py", "tests/project/test_pages_with_a_drive.py")
SHARED = Path(os.environ.get("HIL_SHARED", Path(__file__).parent.parent.parent / "shared"))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--stand",
        metavar="FILE",
        help="Hold the contract of servos against this stand instead. The motor moves: lock the joint, hands off.",
    )


def pytest_configure() -> None:
    """Take every signal that whoever started this has ignored: what tests start would ignore it too.

    A shell ignores SIGINT and SIGQUIT in the background, and `nohup` SIGHUP. A handler that does nothing is not handed
    on to a program that is started, and leaves the tests themselves as deaf as they were asked to be.
    """
    for number in signal.valid_signals() - {signal.SIGPIPE, signal.SIGXFSZ}:  # Python itself ignores these two
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else lambda *_: None)
    gc.disable()  # nothing of the modules that are collected is garbage, and to look for it takes a seventh of the time


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """One stand has one motor: with --stand the tests run one after the other."""
    if config.getoption("--stand") is not None:
        config.option.numprocesses, config.option.dist = 0, "no"


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Run the files of `IN_TURN` in one worker, one after the other.

    Their tests use an emulated drive in real time, or a browser. While a browser runs in another worker, the control
    loop waits for a processor core and its ticks are late.
    """
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class InTurn(LoadFileScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return "in turn" if file in IN_TURN else file

    return InTurn(config, log)


def pytest_collection_finish() -> None:
    """Take what was collected out of the search for garbage: it is kept to the end, and a search of it takes 0.2 s."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def nothing_is_left_running() -> Iterator[None]:
    before, tracer = set(threading.enumerate()), sys.gettrace()
    yield
    sys.settrace(tracer)  # what a signal raises while coverage is at work ends it for all tests to come
    # numba keeps its own pool for the life of the process; everything else a test starts, it ends. A finalizer that
    # logs in a thread that is just ending enters that thread once more, as a dummy, for good
    left = [thread for thread in threading.enumerate() if thread not in before and thread.is_alive()]
    assert [thread for thread in left if not isinstance(thread, threading._DummyThread)] == []
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)


@pytest.fixture(scope="session", autouse=True)
def state_of_its_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What the commands keep between two runs must not come from the person who tests, nor stay with them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(scope="session", autouse=True)
def recordings_are_quick() -> Iterator[None]:
    """Save what costs 100 ms or more for each recording and is the same for all.

    None is tried out in a copy of this process before it is opened, since nearly every test has just written it
    itself; the versions of the software, one of them `git`'s, are looked up once; before a run in real time the
    memory is not searched for what can be freed, which holds all tests here; and the doctor tests a link for 0.2 s.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.recording.reader.in_child", lambda *_, **__: True)
        patch.setattr("hil.recording.input.in_child", lambda work, **_: work())
        patch.setattr("hil.recording.writer._software", SOFTWARE)
        patch.setattr("hil.acquisition.real_time.gc", UNSEARCHED)
        patch.setattr("hil.doctor.link_check._SECONDS", 0.2)
        yield


@pytest.fixture
def damaged_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """Try recordings out in a copy of the process, as a person's are: some damaged files end it."""
    monkeypatch.setattr("hil.recording.reader.in_child", in_child)
    monkeypatch.setattr("hil.recording.input.in_child", in_child)


@pytest.fixture
def busy_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a run in real time go on, and end well, where other work on this machine makes its ticks late."""
    for name, value in ALLOWED.items():
        monkeypatch.setattr(name, value)


@pytest.fixture(scope="session")
def locked_output() -> Path:
    """The real recordings, which are never copied into the repository."""
    folder = SHARED / "data" / "locked_output"
    if not folder.is_dir():
        pytest.skip(f"REAL DATA NOT TESTED: {folder} is missing")
    return folder
