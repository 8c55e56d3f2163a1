"""The guarded process's side of the guardian: start the guardian, send signs of life, check its state, end it."""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import subprocess
from dataclasses import asdict

from drivers.clock import machine_time, no_later
from drivers.off_path import OffPath
from drivers.servo import DriverError
from hil.child import command, shared_memory
from hil.guardian.words import SIZE, Reason, Word, Words, now

_START = 20.0  # s until it must be ready; a fraction of a second is usual
_FROZEN = 0.5  # s without its own sign of life
_END, _END_AT_LEAST = 2.0, 0.05  # s that it may take to end; during a torque-off, less

_FIRED = {
    Reason.STOPPED: "hil was stopped (SIGSTOP, a debugger)",
    Reason.LATE: (
        "hil gave no sign of life for {silence:.0f} ms: lower --rate, free the computer of other work, and do not "
        "suspend it"
    ),
    Reason.TOO_LONG: "the run lasted longer than its profile",
    Reason.ASKED: "the drive did not confirm torque-off",
}


class GuardianFired(DriverError):
    """The error that the guardian has switched the torque off, because this process was stopped or late."""


class GuardianLost(DriverError):
    """The error that the guardian has ended or is frozen: nothing would switch the torque off if this process died."""


def available() -> bool:
    """Return whether this system can run a guardian. Windows cannot, because a child process cannot inherit open
    descriptors there.
    """
    return os.name == "posix"


class Guardian:
    """A running guardian of a drive, as seen from the guarded process.

    path: how the guardian reaches the drive. silence: the time without a sign of life, s, after which the guardian
    switches the torque off. Raises DriverError if the guardian cannot be started, or cannot reach the drive.
    """

    def __init__(self, path: OffPath, silence: float) -> None:
        self._silence = int(silence * 1e9)
        self._words = Words(shared_memory(SIZE))
        try:
            self._process, self._commands = self._started(path)
        except BaseException:
            self._words.close()
            raise

    def _started(self, path: OffPath) -> tuple[subprocess.Popen[bytes], int]:
        """Start the guardian's process. Return the process and the write end of the pipe to it."""
        if os.getpid() == 1:  # of a container; the command line leaves it, another program cannot be made to
            raise _not_started(
                "this program is process 1 of its container, and the kernel would kill the guardian together with it: "
                "start the container with an init, as docker run --init does"
            )
        way = asdict(path) | {"parent": os.getpid(), "words": self._words.descriptor, "resync": path.resync.hex()}
        way |= {"off": _hex(path.off), "restore": _hex(path.restore)}
        heard, commands = os.pipe()
        answers, answer = os.pipe()
        try:
            process = subprocess.Popen(  # noqa: S603 - our own module
                command("hil.guardian.process", json.dumps(way)),
                stdin=heard,
                stdout=answer,
                pass_fds=[number for number in (path.descriptor, path.lock, self._words.descriptor) if number >= 0],
                start_new_session=True,
                cwd="/",
            )
        except OSError as error:
            os.close(commands)
            os.close(answers)
            raise _not_started(error.strerror or str(error)) from None
        finally:
            os.close(heard)
            os.close(answer)
        self._await_ready(process, commands, answers, path.name)
        return process, commands

    def _await_ready(self, process: subprocess.Popen[bytes], commands: int, answers: int, name: str) -> None:
        said = ""
        try:
            ready, _, _ = select.select([answers], [], [], _START)
            said = os.read(answers, 4096).decode("utf-8", "replace").strip() if ready else "it is not ready"
        finally:
            os.close(answers)
            if said != "ready":
                os.close(commands)
                _end(process)
        if said != "ready":
            raise _not_started(f"{name}: {said or 'it ended at once'}")

    def beat(self, takes: float = 0.0) -> None:
        """Give a sign of life. The next sign must come within `silence` s, plus `takes` s for the action that begins
        now.
        """
        self._words[Word.DUE] = now() + self._silence + int(takes * 1e9)

    def expect(self, seconds: float) -> None:
        """Require the next sign of life in `seconds` s; infinity: require none, while the torque is off."""
        self._words[Word.DUE] = now() + int(seconds * 1e9) if math.isfinite(seconds) else 0

    def limit(self, seconds: float) -> None:
        """Require that the torque is off in `seconds` s at the latest; infinity: no such limit."""
        self._words[Word.LATEST] = now() + int(seconds * 1e9) if math.isfinite(seconds) else 0

    @property
    def fired(self) -> bool:
        """Return whether the guardian has switched the torque off."""
        return self._words[Word.FIRED] != 0

    def check(self) -> None:
        """Raise GuardianFired if the guardian has switched the torque off, GuardianLost if it has ended or is
        frozen.
        """
        fired = self._words[Word.FIRED]
        if fired:
            raise GuardianFired(
                f"the guardian switched the torque off: {_FIRED[Reason(fired)].format(silence=self._silence * 1e-6)}"
            )
        status = self._process.poll()
        since = (now() - self._words[Word.ALIVE]) * 1e-9
        if status is None and since < _FROZEN:
            return
        how = (
            f"ended with status {status}"
            if status is not None
            else f"has stood still for {since:.1f} s, or the computer was suspended"
        )
        raise GuardianLost(
            f"the guardian process {how}: nothing would switch the torque off if hil were killed, so the run ends; "
            "start it again, or record with --no-guardian"
        )

    def restore(self, path: OffPath) -> None:
        """Send the guardian the packets that restore the settings which arming has changed."""
        self._say({"restore": _hex(path.restore)})

    def fire(self, *, tried: bool = False) -> None:
        """Let the guardian send the torque-off too, because the drive did not confirm this process's torque-off.

        tried: whether this is only a test, without a message on the terminal.
        """
        self._say({"fire": True, "tried": True} if tried else {"fire": True})

    def stand_down(self) -> None:
        """End the guardian and wait until its process has ended, so that it sends nothing more. Harmless if it has
        ended already.
        """
        self._say({"stand_down": True})
        _end(self._process)

    def close(self) -> None:
        """End the guardian, and release the shared memory."""
        self.stand_down()
        os.close(self._commands)
        self._words.close()

    def _say(self, what: dict[str, object]) -> None:
        with contextlib.suppress(OSError):  # it has ended; `check` finds that out
            os.write(self._commands, json.dumps(what).encode("ascii") + b"\n")


def _end(process: subprocess.Popen[bytes]) -> None:
    now = machine_time()
    try:
        process.wait(max(_END_AT_LEAST, no_later(now + _END) - now))
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _hex(packets: tuple[bytes, ...]) -> list[str]:
    return [packet.hex() for packet in packets]


def _not_started(reason: str) -> DriverError:
    return DriverError(
        f"the guardian cannot be started ({reason}): nothing was driven. It would switch the torque off if hil were "
        "killed or frozen; hil record --no-guardian records without it"
    )
