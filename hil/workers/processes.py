"""Run tasks in processes of this computer: each process has one task at a time, and a process that dies is replaced.

Module `concurrent.futures` has such a pool. But one dead process ends all its tasks, and each of its processes would
run a caller's script again. Here a process reads pickled tasks from its standard input, and ends when the input ends.
"""

from __future__ import annotations

import logging
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from typing import Any, BinaryIO, cast

from hil.child import command
from hil.errors import WrongUse

_TRIES = 3  # of a task whose process dies


@contextmanager
def processes(count: int) -> Iterator[Processes]:
    """Yield an executor of `count` processes. All processes are ended with the block, whatever they are doing."""
    executor = Processes(count)
    try:
        yield executor
    finally:
        executor.shutdown()


class Processes:
    """An executor of `count` processes. A process is started when it gets its first task."""

    def __init__(self, count: int) -> None:
        self._threads = ThreadPoolExecutor(count)
        self._idle: SimpleQueue[_Process] = SimpleQueue()
        self._all = [_Process() for _ in range(count)]
        for process in self._all:
            self._idle.put(process)

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Future[Any]:
        """Run a function in a process and return its future result. The function must be importable by its name; its
        arguments must be picklable.

        The future raises what the function raises, and WrongUse if every process that tried the function died.
        """
        return self._threads.submit(self._tried, function, arguments)

    def shutdown(self) -> None:
        """End all processes. The result of a task that is not complete raises an error."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in self._all:
            process.end(for_good=True)
        self._threads.shutdown()

    def _tried(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        process = self._idle.get()
        try:
            for _ in range(_TRIES):
                with suppress(EOFError, OSError):  # the process died
                    return process.run(function, arguments)
                process.end()
        finally:
            self._idle.put(process)
        raise WrongUse(f"{_TRIES} processes died at the same task: use fewer --workers if memory is short")


class _Process:
    """One worker process, started when it gets its first task."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._starting = threading.Lock()
        self._ended = False

    def run(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Run a function in the process; return its result or raise its error. Raises EOFError or OSError if the
        process died.
        """
        process = self._process or self._started()
        assert process.stdin is not None  # noqa: S101 - for mypy: both are pipes
        assert process.stdout is not None  # noqa: S101
        pickle.dump((function, arguments), process.stdin)
        process.stdin.flush()
        try:
            is_result, value = pickle.load(process.stdout)  # noqa: S301 - from a process of our own
        except ValueError as error:  # its pipe was closed meanwhile, as it ended
            raise EOFError from error
        if not is_result:
            raise value
        return value

    def end(self, *, for_good: bool = False) -> None:
        """End the process if it runs. for_good: whether it must never be started again."""
        with self._starting:
            self._ended = self._ended or for_good
            process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            with suppress(OSError):  # bytes that it did not take any more
                cast("BinaryIO", pipe).close()

    def _started(self) -> subprocess.Popen[bytes]:
        words = command("hil.workers.processes")
        with self._starting:
            if self._ended:
                raise EOFError
            self._process = subprocess.Popen(  # noqa: S603 - our own module, where Ctrl-C does not reach it
                words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
            )
            return self._process


def serve() -> None:
    """Run the tasks that come on standard input until the input ends, and write each result to standard output."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a task prints goes to standard error
    logging.getLogger("ga").setLevel(logging.ERROR)  # one warning for each process would be the same many times
    while True:
        try:
            function, arguments = pickle.load(sys.stdin.buffer)  # noqa: S301 - from the process that started this one
        except EOFError:
            return
        try:
            answer = pickle.dumps((True, function(*arguments)))
        except Exception as error:  # noqa: BLE001 - the caller gets it
            answer = pickle.dumps((False, error))
        answers.write(answer)
        answers.flush()


if __name__ == "__main__":
    serve()
