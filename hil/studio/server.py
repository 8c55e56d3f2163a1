"""The server of the page: its responses, the stream of a run, and how a signal ends the server.

Nothing here drives a motor or switches it off: a run is another process in another session, whose recorder and guardian
do that. If this process is killed, the run goes on to its end; a new `hil studio` in the folder shows and stops it.
"""

from __future__ import annotations

import asyncio
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import resources
from pathlib import Path
from typing import Any, Final

import uvicorn
from anyio import CancelScope, create_task_group
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from hil.acquisition.excitation import EXCITATIONS
from hil.child import command
from hil.errors import Untrustworthy, WrongUse
from hil.report.chart import library
from hil.stand.devices import BACKENDS
from hil.studio.commands import ROUGH, SIZES, stand_of, text_of
from hil.studio.folder import Folder, questions, trace
from hil.studio.guard import TOKEN_PATH, Access, App, Guard
from hil.studio.jobs import Job, Jobs

_FRAME: Final = 0.03  # s between two frames of the traces, which take a few ms
_FIGURES: Final = 0.2  # s between two states of the run
_BODY: Final = 65_536  # bytes of a request
_PRESS: Final = 40  # characters that tell one press of STOP from another
_WARM: Final = 3600  # s that an idle connection stays open, because a stop must not wait for a new one
_TYPES: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
_LIBRARY: Final = {"uPlot.min.js": "script", "uPlot.min.css": "style"}
_REPORT_POLICY: Final = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "frame-ancestors 'self'"
)
"""A report is a file of the folder, and runs its own scripts: as a page of another origin, which reaches nothing."""


def app(access: Access, jobs: Jobs) -> App:
    """Return the ASGI application with its guard. access: token and cookie. jobs: the commands of the folder that it
    shows.
    """
    studio = _Studio(access, jobs)
    routes = [
        Route("/", lambda _: _static("index.html")),
        Route("/static/{name}", lambda request: _static(request.path_params["name"])),
        Route(TOKEN_PATH, studio.enter, methods=["POST"]),
        Route("/api/folder", studio.list_folder),
        Route("/api/questions", lambda request: JSONResponse(questions(request.query_params.get("backend", "")))),
        Route("/api/trace", studio.trace),
        Route("/api/report", studio.report),
        Route("/api/file", studio.download),
        Route("/api/preview", studio.preview, methods=["POST"]),
        Route("/api/start", studio.start, methods=["POST"]),
        Route("/api/stop", studio.stop, methods=["POST"]),
        WebSocketRoute("/api/stream", studio.stream),
    ]
    return Guard(
        Starlette(routes=routes, exception_handlers=dict.fromkeys((WrongUse, Untrustworthy, OSError), _refused)), access
    )


class _Studio:
    def __init__(self, access: Access, jobs: Jobs) -> None:
        self._access, self._jobs, self._folder = access, jobs, jobs.folder
        self._starting, self._reading = threading.Lock(), threading.Lock()
        self._predicting: subprocess.Popen[bytes] | None = None

    async def enter(self, request: Request) -> Response:
        if not self._access.spend(str((await _body(request)).get("token", ""))):
            return PlainTextResponse(
                "this link was used before, or is not the newest: press Enter in the terminal", 403
            )
        answer = JSONResponse({})
        answer.set_cookie(self._access.cookie, self._access.secret, httponly=True, samesite="strict", path="/")
        return answer

    def list_folder(self, request: Request) -> Response:
        asked = request.query_params
        first = asked.get("first", "0")
        recordings, count = self._folder.listed(int(first) if first.isdecimal() else 0, asked.get("find", ""))
        self._jobs.find_foreign()
        kinds = {name: one.explanation for name, one in EXCITATIONS.items() if name != "file"}
        table = {"folder": str(self._folder.place), "stands": self._folder.stands(), "profiles": kinds}
        return JSONResponse(table | {"recordings": recordings, "count": count, "drives": list(BACKENDS)})

    def trace(self, request: Request) -> Response:
        with self._reading:  # a long one after the other: a stop must not wait for many
            return Response(trace(self._named(request)), media_type="application/octet-stream")

    def report(self, request: Request) -> Response:
        policy = {"content-security-policy": _REPORT_POLICY}
        return FileResponse(self._named(request), media_type="text/html", headers=policy)

    def download(self, request: Request) -> Response:
        path = self._named(request)
        return FileResponse(path, filename=path.name, media_type="application/octet-stream")

    def _named(self, request: Request) -> Path:
        return self._folder.place / self._folder.inside(request.query_params.get("name", ""))

    async def preview(self, request: Request) -> Response:
        given = await _body(request)
        return await asyncio.to_thread(self._previewed, given)

    def _previewed(self, given: dict[str, Any]) -> Response:
        running = self._jobs.running
        if running is not None and running.line.moves:
            raise WrongUse("the motor moves: nothing is predicted meanwhile")
        fields = {name: text for name in (*SIZES, *ROUGH) if (text := text_of(given, name))}
        words = command("hil.studio.preview", stand_of(given, self._folder), json.dumps(fields))
        self._give_up_preview()
        process = subprocess.Popen(words, cwd=self._folder.place, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)  # noqa: S603 - our own module
        self._predicting = process
        out, _ = process.communicate()
        return JSONResponse(json.loads(out or b'{"refused": "the prediction was given up"}'))

    def _give_up_preview(self) -> None:
        if self._predicting is not None:
            self._predicting.kill()

    async def start(self, request: Request) -> Response:
        given = await _body(request)
        return JSONResponse({"number": (await asyncio.to_thread(self._started, given)).number})

    def _started(self, given: dict[str, Any]) -> Job:
        with self._starting:
            self._give_up_preview()
            return self._jobs.start(given)

    async def stop(self, request: Request) -> Response:
        self._jobs.stop(request.query_params.get("press", "")[:_PRESS])
        return JSONResponse({"running": self._jobs.running is not None})

    async def stream(self, socket: WebSocket) -> None:
        """Send the state of the command and the rows of its recording until either side ends.

        Reading detects that the page has closed; otherwise this method would send for ever. A message that is read is a
        stop, which arrives some ms before the HTTP request for it.
        """
        await socket.accept()
        async with create_task_group() as group:
            group.start_soon(_read, socket, group.cancel_scope, self._jobs.stop)
            with suppress(WebSocketDisconnect):
                await self._write(socket)
            group.cancel_scope.cancel()

    async def _write(self, socket: WebSocket) -> None:
        job, sent, due = None, 0, 0.0
        shown: tuple[object, ...] = ()
        while True:
            if job is not self._jobs.job:
                job, sent = self._jobs.job, 0
            growing = None if job is None else job.follow()
            if growing is not None:
                frame, sent = growing.frame(sent)
                if frame:
                    await socket.send_bytes(frame)
            known = () if job is None else (job.number, job.status, job.stops, job.off_after)
            now = time.monotonic()
            if job is not None and (known != shown or (job.status is None and now >= due)):
                await socket.send_text(json.dumps(job.state()))
                shown, due = known, now + _FIGURES
            await asyncio.sleep(_FRAME)


async def _read(socket: WebSocket, other: CancelScope, stop: Callable[[str], object]) -> None:
    with suppress(WebSocketDisconnect, KeyError):
        while True:
            stop((await socket.receive_text())[:_PRESS])
    other.cancel()


async def _body(request: Request) -> dict[str, Any]:
    data = b""
    async for chunk in request.stream():
        data += chunk
        if len(data) > _BODY:
            raise WrongUse("the request is too long")
    with suppress(ValueError, RecursionError):
        if isinstance(found := json.loads(data), dict):
            return found
    raise WrongUse("the request is no JSON object")


async def _refused(_request: Request, error: Exception) -> Response:
    return JSONResponse({"refused": str(error)}, 400)


def _static(name: str) -> Response:
    kind = _TYPES.get(Path(name).suffix)
    if name in _LIBRARY:
        return Response(library()[_LIBRARY[name]], media_type=kind)
    file = resources.files("hil.studio").joinpath("static", name)
    if kind is None or Path(name).name != name or not file.is_file():
        return PlainTextResponse("there is no such file", 404)
    return Response(file.read_bytes(), media_type=kind)


class _Server(uvicorn.Server):
    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Install no signal handlers: those of uvicorn would end the server while a motor moves. `_serve` handles the
        signals.
        """
        yield


def bind(port: int) -> socket.socket:
    """Return a socket on 127.0.0.1. port: 0 for any. Raises WrongUse if the port is taken."""
    bound = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind(("127.0.0.1", port))
        bound.listen()
    except OSError as error:
        bound.close()
        raise WrongUse(
            f"port {port} cannot be used ({error.strerror}): another hil studio may use it: press Enter in its "
            "terminal for a link, or choose another port with --port (0: any free port)"
        ) from None
    return bound


def serve(bound: socket.socket, place: Path, say: Callable[[str], object]) -> None:
    """Serve the page of the folder `place` until a signal ends it. say: called with lines for the terminal.

    Ctrl-C stops a run; if nothing moves, it ends the server. A closed terminal and a kill do both.
    """
    access, jobs = Access(bound.getsockname()[1]), Jobs(Folder(place))
    more: dict[str, Any] = {"access_log": False, "log_config": None, "lifespan": "off", "timeout_graceful_shutdown": 1}
    more |= {
        "timeout_keep_alive": _WARM,
        "ws": "websockets-sansio",
        "ws_per_message_deflate": False,
        "ws_max_size": _BODY,
    }
    server = _Server(uvicorn.Config(app(access, jobs), **more))
    try:
        asyncio.run(_serve(server, access, jobs, bound, say))
    finally:
        jobs.end()


async def _serve(
    server: uvicorn.Server, access: Access, jobs: Jobs, bound: socket.socket, say: Callable[[str], object]
) -> None:
    loop = asyncio.get_running_loop()

    def ended() -> None:
        server.should_exit = True

    def interrupted() -> None:
        job = jobs.running
        if job is None or not job.line.moves or job.stops > 1:
            ended()
        else:
            say("stopping the run: its torque ramps to zero; Ctrl-C again switches it off at once, and then ends this")
            jobs.stop()

    def asked() -> None:
        if sys.stdin.readline():
            say(access.link())
        else:  # its end is always readable
            loop.remove_reader(sys.stdin)

    loop.add_signal_handler(signal.SIGINT, interrupted)
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            loop.add_signal_handler(number, ended)
    if sys.stdin is not None and sys.stdin.isatty():
        loop.add_reader(sys.stdin, asked)
    say(f"open {access.link()}")
    say("Enter prints a new link; Ctrl-C stops a run, or ends this")
    await server.serve(sockets=[bound])
