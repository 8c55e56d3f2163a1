"""All commands of `hil`, and the exit status with which each ends."""

from __future__ import annotations

import io
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any, NoReturn, cast

import typer

from hil.acquisition.interrupt import StopRequest
from hil.api.wording import on_the_command_line
from hil.cli.calibrate import calibrate
from hil.cli.demo import demo
from hil.cli.design import design
from hil.cli.doctor import doctor
from hil.cli.emulate import emulate
from hil.cli.examples import Command, below_help, below_main_help
from hil.cli.files import export_data, import_data, inspect, recover, view
from hil.cli.identify import identify
from hil.cli.many.campaign import campaign, hand
from hil.cli.many.compare import compare
from hil.cli.many.hysteresis import hysteresis
from hil.cli.many.report import report
from hil.cli.many.studio import studio
from hil.cli.record import record
from hil.cli.replicate import replicate
from hil.cli.stand import stand
from hil.cli.terminal import (
    DONE,
    INTERNAL_ERROR,
    INTERRUPTED,
    LIMIT_REACHED,
    STAND_FAILED,
    UNTRUSTWORTHY,
    WRONG_USE,
    be_quiet,
    out,
    say,
)
from hil.errors import Untrustworthy, WrongUse, is_shortage, proposing
from hil.process_1 import leave_process_1
from hil.stand.sentences import names_the_value, sentence

app = typer.Typer(
    name="hil",
    help=(
        "Record a robot-hand joint against its locked output and identify the stiffness and damping of its coupling. "
        "Anywhere: --quiet prints the answer and what is wrong with it, and nothing else; --debug shows the traceback "
        "of an error."
    ),
    epilog=below_main_help(),
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_UsageError: type[Exception] = typer.BadParameter.__mro__[1]  # raised by typer for wrong options, not exported

_OPEN_FILES = 32  # files that hil has open at most: a recording, its ports, and the pipes to its processes
_COMMANDS: dict[str, Callable[..., None]] = {
    "record": record,
    "identify": identify,
    "hysteresis": hysteresis,
    "compare": compare,
    "report": report,
    "inspect": inspect,
    "view": view,
    "import": import_data,
    "export": export_data,
    "recover": recover,
    "campaign": campaign,
    "hand": hand,
    "demo": demo,
    "studio": studio,
    "replicate": replicate,
    "design": design,
    "emulate": emulate,
    "doctor": doctor,
}
for _name, _command in _COMMANDS.items():
    app.command(_name, cls=Command, epilog=below_help(_name))(_command)
app.add_typer(stand, name="stand")
app.add_typer(calibrate, name="calibrate")


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        out(f"hil {version('hil')}")
        raise typer.Exit


@app.callback()
def options_of_all(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    """Handle the options that stand before the command, such as --version."""


def main() -> NoReturn:
    """Run the command line and exit with its status. A later Ctrl-C does not change that status.

    Warnings of Python libraries are hidden, because they do not help a user; `python -W` shows them.
    """
    ended = leave_process_1()
    if ended is not None:
        os._exit(ended)
    StopRequest.exit_follows = True
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # to look for them reads a file of every package
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    try:
        status = run(sys.argv[1:])
    except KeyboardInterrupt:
        say("interrupted")
        status = INTERRUPTED
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(status)


@cache
def _commands() -> Any:
    """Return all commands with their options. Building them takes longer than running most commands."""
    return typer.main.get_command(app)


def run(words: list[str]) -> int:
    """Run a command and return its exit status. "--debug" and "--quiet" may be anywhere among the words."""
    be_quiet("--quiet" in words)
    try:
        _check_open_files()
        parsed = [word for word in words if word not in {"--debug", "--quiet"}]
        with on_the_command_line():
            answer = _commands().main(parsed, prog_name="hil", standalone_mode=False)
    except _UsageError as error:
        say(_usage(error))
        return WRONG_USE
    except typer.Exit as error:
        return error.exit_code
    except (typer.Abort, KeyboardInterrupt):
        say("interrupted")
        return INTERRUPTED
    except Exception as error:  # noqa: BLE001 - every error becomes a sentence and a status
        if "--debug" in words:
            say(traceback.format_exc())
        say(f"hil: {error}")
        return _status_of(error)
    return answer if isinstance(answer, int) else DONE


def _check_open_files() -> None:
    """Raise WrongUse if this process may open too few files: libraries would then call a good recording damaged."""
    try:
        import resource
    except ImportError:  # not POSIX
        return
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if 0 <= limit < _OPEN_FILES:
        raise WrongUse(
            f"this computer lets hil open {limit} files, and hil needs {_OPEN_FILES}: ulimit -n {_OPEN_FILES}"
        )


def _usage(error: Exception) -> str:
    """Return an error in the options as one sentence. The texts of the library pydantic are replaced."""
    shown, raised, cause = io.StringIO(), cast("Any", error), cast("Any", error.__cause__)
    if hasattr(cause, "errors"):
        item = cause.errors()[0]
        raised.message = f"{item['input']!r} {sentence(item)}" if names_the_value(item) else sentence(item)
    raised.message = proposing(str(raised.message))
    raised.show(file=shown)
    return shown.getvalue().rstrip("\n")


def _status_of(error: Exception) -> int:
    """Return the exit status of an error; for one that is not the user's, print what to do."""
    from drivers.servo import DriverError
    from hil.acquisition.limits import LimitReached

    if isinstance(error, WrongUse):
        return WRONG_USE
    if isinstance(error, LimitReached):
        return LIMIT_REACHED
    if isinstance(error, DriverError):
        return STAND_FAILED
    if isinstance(error, Untrustworthy):
        return UNTRUSTWORTHY
    if is_shortage(error):
        say("this computer has no more of that for hil: close other programs, or raise the limit (ulimit -n, -u, -v)")
        return WRONG_USE
    say("this is a fault in hil itself: run the command again with --debug and report the output")
    return INTERNAL_ERROR
