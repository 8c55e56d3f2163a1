"""The cache of machine code: found again while the sources are the same, never after they changed."""

from __future__ import annotations

import grp
import logging
import os
import pwd
import signal
import subprocess
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numba
import pytest

from ga.compiled import _compiled_once, compiled, compiled_when_worth
from ga.first_run import announced_to
from ga.machine_code import KEPT, cache_folder, changeable_by_others

CONFIG: Any = numba.config
CALLER = "from ga.compiled import compiled\nfrom joint.{callee} import stiffness\n\n\n@compiled\ndef torque(x):\n    return stiffness() * x\n"  # noqa: E501
CALLEE = "from ga.compiled import compiled\n\n\n@compiled\ndef stiffness():\n    return {value}\n"
ASK = "import joint.caller as caller; print(caller.torque(1.0), sum(caller.torque.stats.cache_hits.values()) > 0)"
ROOT = Path(__file__).parent.parent.parent


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package whose caller is compiled with a function of another module in it."""
    folder = tmp_path / "joint"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "caller.py").write_text(CALLER.format(callee="callee"))
    (folder / "callee.py").write_text(CALLEE.format(value="2.0"))
    return folder


@pytest.fixture(scope="module", autouse=True)
def numba_is_ready() -> None:
    """The first function that a process compiles takes a second, and a copy of the process need not repeat that."""
    numba.njit(lambda x: x * 2.0)(1.0)


def begin(question: str, package: Path, cache: Path) -> tuple[int, int]:
    """A copy of this process that finds the package and this cache: its number, and the pipe it answers through."""
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the copy uses none of theirs
        child = os.fork()
    if child == 0:
        try:
            os.environ["XDG_CACHE_HOME"], CONFIG.CACHE_DIR = str(cache), ""
            sys.path.insert(0, str(package.parent))
            sys.dont_write_bytecode = True
            logging.getLogger().handlers.clear()  # pytest's, which keep what is said
            with os.fdopen(writing, "w") as file, redirect_stdout(file), redirect_stderr(file):
                exec(question, {})  # noqa: S102 - ours
        finally:
            os._exit(0)
    os.close(writing)
    return child, reading


def end(child: int, reading: int) -> str:
    """What it printed, also to standard error."""
    with os.fdopen(reading) as file:
        printed = file.read()
    os.waitpid(child, 0)
    return printed


def ask(package: Path, cache: Path) -> tuple[float, bool]:
    """What the compiled caller returns in another process, and whether its machine code came from the cache."""
    return answered(end(*begin(ASK, package, cache)))


def answered(printed: str) -> tuple[float, bool]:
    value, found = printed.split()
    return float(value), found == "True"


def rewrite(source: Path, text: str) -> None:
    """Change a source and leave its time of change as it was."""
    before = source.stat()
    source.write_text(text)
    os.utime(source, ns=(before.st_atime_ns, before.st_mtime_ns))


def test_kept_machine_code_is_loaded_without_what_numba_needs_to_compile(package: Path, tmp_path: Path) -> None:
    ask(package, tmp_path / "cache")  # compiles it
    question = f"{ASK}; import sys; print('numba.np.arrayobj' in sys.modules)"
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": f"{package.parent}:{ROOT}"}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-c", question]
    said = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert said.split() == ["2.0", "True", "False"]


@pytest.mark.study
def test_of_two_processes_that_need_a_function_one_compiles_it(package: Path, tmp_path: Path) -> None:
    asked = [begin(ASK, package, tmp_path / "cache") for _ in range(2)]
    assert sorted(answered(end(*one)) for one in asked) == [(2.0, False), (2.0, True)]


def test_python_runs_a_function_until_compiling_it_is_worth_the_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ga.compiled.cache_folder", lambda _package: tmp_path)
    heard: list[int] = []
    with announced_to(heard.append):
        torque = compiled_when_worth(lambda x: x * 2.0)
        assert torque(1.0) == 2.0
        assert not heard
        monkeypatch.setattr(compiled_when_worth, "worth", 0.0)
        assert torque(1.0) == 2.0
    assert heard == [0, 1]


def test_what_is_compiled_is_announced_when_it_begins_and_when_it_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ga.compiled.cache_folder", lambda _package: tmp_path)  # an earlier run has compiled it already
    heard: list[int] = []
    with announced_to(heard.append):
        compiled(lambda x: x + 1.0)(2.0)
    assert heard == [0, 1]


@pytest.mark.study
def test_a_changed_function_of_another_module_is_compiled_again_and_a_former_one_found(
    package: Path, tmp_path: Path
) -> None:
    assert ask(package, tmp_path / "cache") == (2.0, False)
    rewrite(package / "callee.py", CALLEE.format(value="3.0"))
    assert ask(package, tmp_path / "cache") == (3.0, False)
    rewrite(package / "callee.py", CALLEE.format(value="2.0"))
    assert ask(package, tmp_path / "cache") == (2.0, True)


@pytest.mark.study
def test_machine_code_of_a_moved_module_is_never_used(package: Path, tmp_path: Path) -> None:
    """Another module takes the old one's place, older than all that was ever compiled."""
    assert ask(package, tmp_path / "cache") == (2.0, False)
    (package / "parts").mkdir()
    (package / "parts" / "__init__.py").touch()
    (package / "callee.py").rename(package / "parts" / "callee.py")
    (package / "callee.py").write_text(CALLEE.format(value="5.0"))
    os.utime(package / "callee.py", (0, 0))
    assert ask(package, tmp_path / "cache") == (5.0, False)
    rewrite(package / "caller.py", CALLER.format(callee="parts.callee"))
    assert ask(package, tmp_path / "cache") == (2.0, False)


def test_without_a_folder_that_can_be_written_the_package_keeps_its_machine_code(package: Path) -> None:
    assert ask(package, package / "__init__.py") == (2.0, False)
    assert ask(package, package / "__init__.py") == (2.0, True)
    assert list(package.rglob("*.nbi"))


FULL = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)); "


@pytest.mark.parametrize(("cache", "first"), [("joint/__init__.py", ""), ("cache", FULL)], ids=["read-only", "full"])
def test_where_nothing_can_be_written_the_program_works_and_says_so_once(
    package: Path, tmp_path: Path, cache: str, first: str
) -> None:
    (package / "__pycache__").write_text("a file where the folder would be")
    *said, result = end(*begin(first + ASK, package, tmp_path / cache)).splitlines()  # a slow machine prints more
    assert sum("compiled functions cannot be kept" in line for line in said) == 1
    assert result == "2.0 False"
    assert not list(tmp_path.rglob("*.nbi"))


def test_machine_code_that_others_can_change_is_not_run_which_is_said_once(package: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    ask(package, cache)
    (cache / "hil").chmod(0o777)
    *said, result = end(*begin(ASK, package, cache)).splitlines()
    assert result == "2.0 False"
    assert sum(f"others can change {cache / 'hil'} " in line for line in said) == 1


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a file away")
@pytest.mark.parametrize(
    ("place", "owner", "group", "mode"),
    [
        ("home", 12345, 0, 0o755),
        ("home", 12345, 0, 0o1777),
        ("home", 0, 12345, 0o775),
        ("home", 0, 0, 0o757),
        ("home/code", 12345, 0, 0o700),
        ("home/code", 0, 12345, 0o750),
        ("home/code/a.nbi", 12345, 0, 0o600),
    ],
)
def test_another_owner_and_a_folder_that_others_write_are_recognised(
    tmp_path: Path, place: str, owner: int, group: int, mode: int
) -> None:
    folder = tmp_path / "home" / "code"
    folder.mkdir(parents=True)
    folder.chmod(0o700)
    (folder / "a.nbi").touch()
    assert changeable_by_others(folder) is None
    changed = tmp_path / place
    os.chown(changed, owner, group)
    changed.chmod(mode)
    assert changeable_by_others(folder) == changed


@pytest.mark.parametrize("mode", [0o1777, 0o775])
def test_a_folder_for_all_whose_entries_stay_their_owners_and_the_users_own_group_are_no_danger(
    tmp_path: Path, mode: int
) -> None:
    own = tmp_path / "own"
    own.mkdir(mode=0o700)
    tmp_path.chmod(mode)
    name = grp.getgrgid(tmp_path.stat().st_gid).gr_name
    alone = mode == 0o1777 or name == pwd.getpwuid(os.geteuid()).pw_name
    assert changeable_by_others(own) == (None if alone else tmp_path)


def test_a_folder_is_closed_to_others_whatever_the_umask_allows(package: Path, tmp_path: Path) -> None:
    first = "import os; os.umask(0); "
    assert answered(end(*begin(first + ASK, package, tmp_path / "cache"))) == (2.0, False)
    assert answered(end(*begin(first + ASK, package, tmp_path / "cache"))) == (2.0, True)
    assert {folder.stat().st_mode & 0o777 for folder in (tmp_path / "cache").rglob("joint-*")} == {0o700}


@pytest.mark.study
def test_a_file_of_the_cache_that_is_empty_cut_or_zeros_is_replaced(package: Path, tmp_path: Path) -> None:
    ask(package, tmp_path)
    for pattern, part, filling in (("*.nbi", 0.0, 0), ("*.nbi", 0.5, 0), ("*.nbc", 0.5, 0), ("*.nbc", 0.0, 1)):
        for file, data in {file: file.read_bytes() for file in tmp_path.rglob(pattern)}.items():
            file.write_bytes(data[: int(part * len(data))] + filling * bytes(len(data)))
        assert ask(package, tmp_path)[0] == 2.0
    assert ask(package, tmp_path) == (2.0, True)


def test_only_the_last_used_folders_are_kept(package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CONFIG, "CACHE_DIR", str(tmp_path / "cache"))
    for age in range(KEPT + 3):
        old = tmp_path / "cache" / f"joint-{age}"
        old.mkdir(parents=True)
        os.utime(old, (age, age))
    other = tmp_path / "cache" / "jointly-1"
    other.mkdir()
    folder = cache_folder(package)
    kept = set((tmp_path / "cache").iterdir())
    assert kept == {folder, other} | {tmp_path / "cache" / f"joint-{age}" for age in range(4, KEPT + 3)}


def test_the_users_own_setting_of_numba_is_left_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for setting in ("", str(tmp_path)):
        monkeypatch.setattr(CONFIG, "CACHE_DIR", setting)
        compiled(lambda x: x)
        assert setting == CONFIG.CACHE_DIR


def test_ctrl_c_while_a_function_is_compiled_ends_the_work_once_that_function_is_done(tmp_path: Path) -> None:
    done: list[str] = []

    def inner() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        done.append("inner")

    def outer() -> None:
        _compiled_once(inner, tmp_path / "inner.lock")
        done.append("outer")

    with pytest.raises(KeyboardInterrupt):
        _compiled_once(outer, tmp_path / "outer.lock")
    assert done == ["inner"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    _compiled_once(lambda: done.append("next"), tmp_path / "next.lock")
    assert done == ["inner", "next"]


@pytest.mark.study
def test_the_working_directory_says_nothing_of_where_machine_code_is(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file of numba's settings there, and a user without a home, whose folders are relative: "~/.cache"."""
    monkeypatch.chdir(tmp_path)
    Path(".numba_config.yaml").write_text("cache_dir: planted\ndisable_jit: 1\n")
    search = os.pathsep.join([str(package.parent), str(ROOT)])
    env = {**os.environ, "PYTHONPATH": search, "XDG_CACHE_HOME": str(tmp_path / "cache")}
    env.pop("NUMBA_CACHE_DIR", None)
    run = subprocess.run([sys.executable, "-c", ASK], capture_output=True, text=True, check=True, env=env)
    assert answered(run.stdout) == (2.0, False)
    assert (tmp_path / "cache").exists()
    monkeypatch.setattr("ga.machine_code._appdirs.user_cache_dir", lambda *_, **__: "~/.cache/hil")
    assert cache_folder(package) == package / "__pycache__" / next((package / "__pycache__").glob("joint-*")).name
    assert not Path("planted").exists()
    assert not Path("~").exists()
