"""Access control of the page: one ASGI middleware for requests and websockets, and the key that admits a browser.

A page of another site can send requests to 127.0.0.1 from the browser of the person at the bench. The fixed list of
hosts refuses a page whose host name was rebound to 127.0.0.1; the checks of origin and key refuse all others. Browsers
apply neither CORS nor the same-origin policy to websockets, so their origin is checked here as well. There is no
cookie: a browser sends it to every port of the computer, so to the servers of other users too.
"""

from __future__ import annotations

import secrets
from typing import Any, Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from hil.errors import WrongUse
from hil.studio.peers import Strangers

TOKEN_PATH: Final = "/token"  # noqa: S105 - a path
TICKET_PATH: Final = "/ticket/"
_TICKETS: Final = 100  # that are valid, the newest
_READING: Final = frozenset({"GET", "HEAD"})
_HEADERS: Final = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "x-dns-prefetch-control": "off",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


class Access:
    """The token of the printed link, the key that replaces it in the page, and the tickets for single files.

    port: of the server. strangers: the connections that have not shown the key.
    """

    def __init__(self, port: int) -> None:
        self.port = port
        self.hosts = frozenset({f"127.0.0.1:{port}", f"localhost:{port}"})
        self.key = secrets.token_urlsafe(32)
        self.strangers = Strangers()
        self._token = ""
        self._tickets: dict[str, tuple[str, str]] = {}

    def link(self) -> str:
        """Return a new link; an earlier link that was not opened becomes invalid.

        The token stands behind '#': no log, no Referer header and no program that fetches links in advance sees it.
        """
        self._token = secrets.token_urlsafe(32)
        return f"http://127.0.0.1:{self.port}/#{self._token}"

    def spend(self, token: str) -> bool:
        """Return whether `token` is the link's token, and make the link invalid if it is."""
        right = bool(self._token) and _same(token, self._token)
        if right:
            self._token = ""
        return right

    def admits(self, key: str, peer: Any) -> bool:
        """Return whether `key` is the page's key; the connection from `peer` is no stranger then."""
        right = _same(key, self.key)
        if right:
            self.strangers.remove(peer)
        return right

    def ticket(self, kind: str, name: str) -> str:
        """Return an address of the file `name` for a frame or a download, which cannot send the key."""
        ticket = secrets.token_urlsafe(32)
        self._tickets[ticket] = kind, name
        if len(self._tickets) > _TICKETS:
            del self._tickets[next(iter(self._tickets))]
        return f"{TICKET_PATH}{ticket}"

    def file_of(self, ticket: str) -> tuple[str, str]:
        """Return kind and name of the file that the ticket stands for. Raises WrongUse."""
        if ticket not in self._tickets:
            raise WrongUse("this address is no longer valid: choose the file in the page again")
        return self._tickets[ticket]

    def refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Return the HTTP status and the reason for refusing a request or a websocket; None if it is allowed.

        A websocket must send the key as its first message.
        """
        headers = Headers(scope=scope)
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        if len(hosts) != 1 or hosts[0] not in self.hosts:
            return 421, f"this page is http://127.0.0.1:{self.port}: open the link that hil studio printed"
        method, path = scope.get("method", "websocket"), scope["path"]
        if method in _READING and (path == "/" or path.startswith("/static/")):
            return None  # a shell without data
        foreign = any(site != "same-origin" for site in headers.getlist("sec-fetch-site"))
        foreign = foreign or not {f"http://{one}" for one in self.hosts}.issuperset(origins)
        if foreign or not (origins or method in _READING):
            return 403, "the request does not come from this page"
        open_to_all = (method, path) == ("POST", TOKEN_PATH) or (method in _READING and path.startswith(TICKET_PATH))
        keys = headers.getlist("authorization")
        has_key = len(keys) == 1 and self.admits(keys[0].removeprefix("Bearer "), scope.get("client"))
        if method == "websocket" or open_to_all or has_key:
            return None
        return 401, "open the link that hil studio printed; Enter in its terminal prints a new one"


class Guard:
    """The middleware: it refuses what `access` refuses, and adds the headers that keep foreign scripts out of the
    page.
    """

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request (the call of the ASGI interface)."""

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        answer, refused = self._app, None if scope["type"] == "lifespan" else self._access.refusal(scope)
        if refused is not None:
            status, reason = refused
            is_socket = scope["type"] == "websocket"
            answer = WebSocketClose(4403, reason) if is_socket else PlainTextResponse(reason, status)
        await answer(scope, receive, sending)


def _same(given: str, right: str) -> bool:
    """Compare in a time that does not depend on the texts."""
    return secrets.compare_digest(given.encode(errors="replace"), right.encode())
