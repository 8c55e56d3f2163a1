"""Tasks on a Dask cluster (extra `cluster`). If a worker dies, the scheduler gives its tasks to another worker."""

from __future__ import annotations

import logging
import threading
import warnings
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from hil.errors import WrongUse

_PATIENCE = 3.0  # s for a scheduler to answer; with the time to load Dask it stays below 5 s
_WITHOUT_WORKERS = 30.0  # s; a worker that dies is started again by its nanny within a few
_LOOK = 1.0  # s between two looks at the workers


@contextmanager
def dask_executor(address: str, count: int) -> Iterator[Any]:
    """Yield an executor for the scheduler at `address`; for "local", start a scheduler with `count` worker processes.

    Raises WrongUse if Dask is not installed, no scheduler answers, or the scheduler has no workers.
    """
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise WrongUse("--cluster needs Dask: pip install 'hil[cluster]'") from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # a worker that dies is no news for the user
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if address == "local":
            with (
                distributed.LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None) as cluster,
                distributed.Client(cluster, set_as_default=False) as client,
                _said(address),
                _attended(client, address),
            ):
                yield client.get_executor(pure=False)
            return
        with _connected(distributed.Client, address) as client, _said(address), _attended(client, address):
            _check_versions(client, address)
            yield client.get_executor(pure=False)


def _connected(make: Any, address: str) -> Any:
    try:
        client = make(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise WrongUse(
            f"--cluster {address}: no Dask scheduler answers there ({_first_line(error)}): start one with "
            "`dask scheduler`, and workers with `dask worker ADDRESS`"
        ) from None
    if not client.scheduler_info()["workers"]:
        client.close()
        raise WrongUse(f"--cluster {address}: the scheduler has no workers: start one with `dask worker {address}`")
    return client


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


def _check_versions(client: Any, address: str) -> None:
    """Raise WrongUse if a worker has another version of hil or none, because its results might differ."""
    own = installed()
    seen = client.run(installed, on_error="return").values()
    others = sorted({one if isinstance(one, str) else "none" for one in seen} - {own})
    if others:
        raise WrongUse(
            f"--cluster {address}: its workers have hil {', '.join(others)}, and this is hil {own}: install the same "
            "version there"
        )


@contextmanager
def _attended(client: Any, address: str) -> Iterator[None]:
    """While the block runs, raise WrongUse if no worker remains for long: the scheduler would keep the tasks
    forever.
    """
    ended, alone = threading.Event(), threading.Event()
    thread = threading.Thread(target=_attend, args=(client, ended, alone), daemon=True)
    thread.start()
    try:
        yield
    except CancelledError:
        if not alone.is_set():
            raise
        raise WrongUse(
            f"--cluster {address}: no worker has been left for {_WITHOUT_WORKERS:.0f} s, so that no recording can be "
            f"identified: start one with `dask worker {address}`, and run the command again"
        ) from None
    finally:
        ended.set()
        thread.join()


def _attend(client: Any, ended: threading.Event, alone: threading.Event) -> None:
    waited = 0.0
    while not ended.wait(_LOOK):
        with suppress(OSError):  # a scheduler that is gone has cancelled the tasks itself
            waited = 0.0 if client.scheduler_info()["workers"] else waited + _LOOK
        if waited >= _WITHOUT_WORKERS:
            alone.set()
            client.close()  # cancels its tasks, so that who waits for them goes on
            return


@contextmanager
def _said(address: str) -> Iterator[None]:
    """Convert errors of the cluster in the block to a WrongUse with one sentence."""
    from distributed import KilledWorker

    try:
        yield
    except KilledWorker:
        raise WrongUse(f"--cluster {address}: several workers died at the same task: give them more memory") from None
    except CancelledError:
        raise WrongUse(f"--cluster {address}: the scheduler is gone: start it, and run the command again") from None


def installed() -> str:
    """Return the installed version of hil, "not installed" for a checkout."""
    try:
        return version("hil")
    except PackageNotFoundError:
        return "not installed"
