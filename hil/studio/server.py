"""The server of the page: its answers, the stream of a run, and how a signal ends the server.

Nothing here drives a motor or switches it off: a run is another process in another session, whose recorder and guardian
do that. If this process is killed, the run goes on to its end; a new `hil studio` in the folder shows and stops it.

The page sends its key with each request, and as the first message of the stream. Then the stream sends binary frames
(`Growing.frame`) and JSON texts: the state (`Jobs.state`), and an answer {"press", "running"} to each later message of
the page, which is a press of STOP. The page sends each press as a request as well, which gets the same answer.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import os
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from importlib import resources
from pathlib import Path
from typing import Any, Final

import uvicorn
from anyio import CancelScope, create_task_group
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from hil.acquisition.excitation import EXCITATIONS
from hil.child import command
from hil.errors import Untrustworthy, WrongUse
from hil.report.chart import library
from hil.stand.devices import BACKENDS
from hil.studio.commands import ROUGH, SIZES, line_of, stand_of, text_of
from hil.studio.folder import Folder, questions, trace
from hil.studio.guard import TICKET_PATH, TOKEN_PATH, Access, Guard
from hil.studio.jobs import Jobs

_FRAME: Final = 0.03  # s between two frames of the traces, which take a few ms
_FIGURES: Final = 0.2  # s between two states of the run
_BODY: Final = 65_536  # bytes of a request
_PRESS: Final = 40  # characters that tell one press of STOP from another
_SERVER: Final[dict[str, Any]] = {
    "access_log": False,
    "log_config": None,
    "lifespan": "off",
    "timeout_graceful_shutdown": 1,
    "timeout_keep_alive": 3600,  # s, because a stop must not wait for a new connection
    "ws": "websockets-sansio",
    "ws_per_message_deflate": False,
    "ws_max_size": _BODY,
    "backlog": 512,  # connections that are accepted at a time; with those that wait, fewer than open files allowed
}
_TYPES: Final = {"html": "text/html", "css": "text/css", "js": "text/javascript"}

Given = Mapping[str, Any]


def app(access: Access, jobs: Jobs) -> ASGIApp:
    """Return the ASGI application with its guard. access: token and key. jobs: the commands of the folder that it
    shows.
    """
    studio, library_of = _Studio(access, jobs), library()
    shell = {one.name: one.read_bytes() for one in resources.files("hil.studio").joinpath("static").iterdir()}
    shell |= {"uPlot.min.js": library_of["script"].encode(), "uPlot.min.css": library_of["style"].encode()}

    def static(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        known = name in shell
        return Response(shell[name], media_type=_TYPES[name.rpartition(".")[2]]) if known else Response("", 404)

    posted = {TOKEN_PATH: studio.enter, "/api/preview": studio.preview, "/api/line": studio.line}
    posted["/api/start"] = studio.start
    asked = {"/api/folder": studio.list_folder, "/api/trace": studio.trace, "/api/ticket": studio.ticket}
    asked["/api/questions"] = lambda given: questions(given.get("backend", ""))
    routes = [
        Route("/", static),
        Route("/static/{name}", static),
        Route(f"{TICKET_PATH}{{ticket}}", studio.file),
        Route("/api/stop", studio.stop, methods=["POST"]),
        Route("/api/acknowledge", studio.acknowledge, methods=["POST"]),
        *(_route(path, work, "POST") for path, work in posted.items()),
        *(_route(path, work, "GET") for path, work in asked.items()),
        WebSocketRoute("/api/stream", studio.stream),
    ]
    refusals = dict.fromkeys((WrongUse, Untrustworthy, OSError), _refused)
    return Guard(Starlette(routes=routes, exception_handlers=refusals), access)


def _route(path: str, work: Callable[[Given], Any], method: str) -> Route:
    """Return the route that answers with what `work` makes, in a thread, of the texts of an address or of a body."""

    async def answer(request: Request) -> Response:
        given = await _body(request) if method == "POST" else dict(request.query_params)
        return _json(await run_in_threadpool(work, given))

    return Route(path, answer, methods=[method])


class _Studio:
    def __init__(self, access: Access, jobs: Jobs) -> None:
        self._access, self._jobs, self._folder = access, jobs, jobs.folder
        self._starting, self._reading = threading.Lock(), threading.Lock()
        self._predicting: subprocess.Popen[bytes] | None = None

    def enter(self, given: Given) -> Any:
        if self._access.spend(str(given.get("token", ""))):
            return {"key": self._access.key}
        return PlainTextResponse("this link was used before, or is not the newest: press Enter in the terminal", 403)

    def list_folder(self, given: Given) -> Any:
        first = given.get("first", "")[:9]
        kinds = {name: one.explanation for name, one in EXCITATIONS.items() if name != "file"}
        table = {"folder": str(self._folder.place), "profiles": kinds, "drives": list(BACKENDS)}
        with self._reading:
            recordings, count = self._folder.listed(int(first) if first.isdecimal() else 0, given.get("find", ""))
            stands = self._folder.stands()
            self._jobs.find_foreign()
        return table | {"stands": stands, "recordings": recordings, "count": count}

    def trace(self, given: Given) -> Response:
        name = self._folder.inside(given.get("name", ""))
        with self._reading:  # a long one after the other: a stop must not wait for many
            return Response(trace(self._folder.place / name), media_type="application/octet-stream")

    def ticket(self, given: Given) -> Any:
        name = self._folder.inside(given.get("name", ""))
        return {"address": self._access.ticket(given.get("kind", ""), str(name))}

    def file(self, request: Request) -> Response:
        kind, name = self._access.file_of(request.path_params["ticket"])
        path = self._folder.place / self._folder.inside(name)
        if kind != "report":
            return FileResponse(path, filename=path.name, media_type="application/octet-stream")
        if request.headers.get("sec-fetch-dest", "iframe") != "iframe":
            return PlainTextResponse("a report is shown in the page only", 403)
        return FileResponse(path, media_type="text/html", headers={"content-security-policy": _report_policy()})

    def preview(self, given: Given) -> Any:
        running = self._jobs.running
        if running is not None and running.line.moves:
            raise WrongUse("the motor moves: nothing is predicted meanwhile")
        fields = {name: text for name in (*SIZES, *ROUGH) if (text := text_of(given, name))}
        words = command("hil.studio.preview", *stand_of(given, self._folder), json.dumps(fields))
        self._give_up_preview()
        process = subprocess.Popen(words, cwd=self._folder.place, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)  # noqa: S603 - our own module
        self._predicting = process
        return json.loads(process.communicate()[0] or b'{"refused": "the prediction was given up"}')

    def _give_up_preview(self) -> None:
        if self._predicting is not None:
            self._predicting.kill()

    def line(self, given: Given) -> Any:
        """Answer with the command line that the same request to `start` would run."""
        return {"command": shlex.join(["hil", *line_of(given, self._folder).words])}

    def start(self, given: Given) -> Any:
        with self._starting:
            self._give_up_preview()
            return {"number": self._jobs.start(given).number}

    async def stop(self, request: Request) -> Response:
        return _json(self._jobs.stop(request.query_params.get("press", "")[:_PRESS]))

    async def acknowledge(self, _request: Request) -> Response:
        self._jobs.acknowledge()
        return _json({})

    async def stream(self, socket: WebSocket) -> None:
        """Send the state of the command and the rows of its recording until either side ends.

        Reading detects that the page has closed; otherwise this method would send for ever.
        """
        await socket.accept()
        with suppress(WebSocketDisconnect, KeyError, RuntimeError):
            if not self._access.admits(await socket.receive_text(), socket.client):
                await socket.close(4401)
                return
            async with create_task_group() as group:
                group.start_soon(self._read, socket, group.cancel_scope)
                with suppress(WebSocketDisconnect):
                    await self._write(socket)
                group.cancel_scope.cancel()
        self._access.strangers.remove(socket.client)

    async def _read(self, socket: WebSocket, other: CancelScope) -> None:
        with suppress(WebSocketDisconnect, KeyError):
            while True:
                answer = self._jobs.stop((await socket.receive_text())[:_PRESS])
                await socket.send_text(_text(answer))
        other.cancel()

    async def _write(self, socket: WebSocket) -> None:
        job, sent, due = None, None, 0.0
        shown: object = None
        while True:
            if job is not self._jobs.job:
                job = self._jobs.job
                sent = 0 if job is self._jobs.running else None  # what ended before would hide the next preview
            growing = None if job is None or sent is None else job.follow()
            if growing is not None:
                frame, sent = growing.frame(sent or 0)
                if frame:
                    await socket.send_bytes(frame)
            known, now = self._jobs.changes(), time.monotonic()
            if known != shown or (self._jobs.running is not None and now >= due):
                await socket.send_text(_text(self._jobs.state()))
                shown, due = known, now + _FIGURES
            await asyncio.sleep(_FRAME)


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


def _json(found: Any, status: int = 200) -> Response:
    return found if isinstance(found, Response) else Response(_text(found), status, media_type="application/json")


def _text(table: Any) -> str:
    """Return JSON in ASCII, because names of files need not be UTF-8, with null for what JSON has no number for."""
    return json.dumps(json.loads(json.dumps(table), parse_constant=lambda _: None))


async def _refused(_request: Request, error: Exception) -> Response:
    return _json({"refused": str(error)}, 400)


def _report_policy() -> str:
    """Return the policy of a report, a file of the folder that anybody may have written: it runs hil's own scripts only
    and reaches nothing.

    It is shown in a frame, whose page allows no other address: a window of its own could go to any, with its data.
    """
    digests = (hashlib.sha256(library()[one].encode()).digest() for one in ("script", "start"))
    scripts = " ".join(f"'sha256-{base64.b64encode(one).decode()}'" for one in digests)
    sources = f"script-src {scripts}; style-src 'unsafe-inline'; img-src data:"
    return f"sandbox allow-scripts; default-src 'none'; {sources}; frame-ancestors 'self'"


def _checked(access: Access) -> type[asyncio.Protocol]:
    """Return the HTTP protocol for connections that are strangers until they have shown the key."""

    class Checked(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            access.strangers.add(transport)

        def connection_lost(self, exc: Exception | None) -> None:
            access.strangers.remove(self.client)
            super().connection_lost(exc)

    return Checked


def bind(port: int) -> socket.socket:
    """Return a socket on 127.0.0.1. port: 0 for any. Raises WrongUse if the port is taken."""
    try:
        return socket.create_server(("127.0.0.1", port))
    except OSError as error:
        raise WrongUse(
            f"port {port} cannot be used ({os.strerror(error.errno or 0)}): another hil studio may use it: press Enter "
            "in its terminal for a link, or choose another port with --port (0: any free port)"
        ) from None


def serve(bound: socket.socket, place: Path, say: Callable[[str], object]) -> None:
    """Serve the page of the folder `place` until a signal ends it. say: called with lines for the terminal.

    Ctrl-C stops a run; if nothing moves, it ends the server. A closed terminal and a kill do both.
    """
    access, jobs = Access(bound.getsockname()[1]), Jobs(Folder(place))
    server = uvicorn.Server(uvicorn.Config(app(access, jobs), http=_checked(access), **_SERVER))
    server.capture_signals = nullcontext  # type: ignore[assignment, method-assign] # its handlers would end it while a motor moves
    try:
        asyncio.run(_serve(server, access, jobs, bound, say))
    finally:
        jobs.end()


async def _serve(
    server: uvicorn.Server, access: Access, jobs: Jobs, bound: socket.socket, say: Callable[[str], object]
) -> None:
    loop = asyncio.get_running_loop()

    def interrupted(number: int) -> None:
        job = jobs.running
        if number != signal.SIGINT or job is None or not job.line.moves or job.stops > 1:
            server.should_exit = True
        else:
            say("stopping the run: its torque ramps to zero; Ctrl-C again switches it off at once, and then ends this")
            jobs.stop()

    def asked() -> None:
        if sys.stdin.readline():
            say(access.link())
        else:  # its end is always readable
            loop.remove_reader(sys.stdin)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            loop.add_signal_handler(number, interrupted, number)
    if sys.stdin is not None and sys.stdin.isatty():
        loop.add_reader(sys.stdin, asked)
    say(f"open {access.link()}")
    say("Enter prints a new link; Ctrl-C stops a run, or ends this")
    await server.serve(sockets=[bound])
