"""Requests, messages and folders that nobody meant: refused with a reason, without a fault, in bounded memory."""

from __future__ import annotations

import json
import os
import random
import resource
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="PAGE NOT TESTED: pip install 'hil[studio]'")

from starlette.testclient import TestClient

from hil.studio.folder import Folder
from hil.studio.guard import Access
from hil.studio.jobs import Jobs
from hil.studio.server import app

PORT = 8455
ODD: list[Any] = [
    "",
    "sim",
    "a.toml",
    "../x",
    "/dev/zero",
    "a\0b",
    "\ud800",
    "9" * 5000,
    "²",
    "-1",
    "1e999",
    "nan",
    "--x",
]
ODD += [
    "record",
    "stand",
    "export",
    "identify",
    "dynamixel",
    "x" * 300,
    "file",
    "report",
    None,
    True,
    1e300,
    [],
    {},
    [1],
    ["a.h5"],
]
TEXTS = [one for one in ODD if isinstance(one, str) and one != "\ud800"]
FIELDS = [
    "kind",
    "stand",
    "recordings",
    "profile",
    "amplitude",
    "band",
    "duration",
    "rate",
    "mode",
    "kc",
    "suffix",
    "yes",
]
FIELDS += ["file", "answers", "backend", "token"]
GET = ["folder", "questions", "trace", "ticket"]
BODIES = [b"", b"[]", b"{", b"\xff\xfe", b"[" * 9000, b"9" * 5000, b'{"kind": NaN}']
CONTENTS = [
    b"",
    b"[stand]\n",
    b"[stand]\nname = 1e400",
    b"[limits]\ntorque = " + b"9" * 5000,
    b"\x89HDF\r\n\x1a\n" + bytes(300),
]
CONTENTS += [
    b"<title>a: " + b"&#1114112;" * 9 + b"</title>",
    b'[stand]\nname="a"\nbackend="sim"\n[limits]\ntorque=inf\n',
    b"\xff" * 99,
]


def put(folder: Path, dice: random.Random) -> None:
    """Replace an entry of the folder by anything."""
    stem = dice.choice([b"a", b"recordings", b"-f", b"\xff", b"\xe2\x80\xae", b"n\nl", b".#b"])
    path = os.path.join(os.fsencode(folder), stem + dice.choice([b".toml", b".h5", b".html", b".h5.part", b""]))  # noqa: PTH118
    if os.path.islink(path) or (os.path.exists(path) and not os.path.isdir(path)):  # noqa: PTH110, PTH112, PTH114
        os.unlink(path)  # noqa: PTH108
    if os.path.isdir(path):  # noqa: PTH112
        return
    kind = dice.randrange(5)
    if kind == 0:
        os.symlink(dice.choice([b"/dev/zero", b"gone", path, b"/etc/passwd", b".", b"a.h5"]), path)  # noqa: PTH211
    elif kind == 1:
        os.mkfifo(path)
    elif kind == 2 and not stem.startswith(b"rec"):
        os.mkdir(path)  # noqa: PTH102
    else:
        with open(path, "wb") as file:  # noqa: PTH123
            file.write(dice.choice(CONTENTS))


@pytest.mark.parametrize("cases", [60, pytest.param(5000, marks=pytest.mark.study)])
def test_nothing_that_is_sent_or_lies_in_the_folder_makes_the_page_fail(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cases: int
) -> None:
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # of all tests before, in this process
    said = [sys.executable, "-S", "-c", "print('{}')"]
    monkeypatch.setattr("hil.studio.jobs.command", lambda *_: said)
    monkeypatch.setattr("hil.studio.server.command", lambda *_: said)
    access, dice, jobs = Access(PORT), random.Random(0), Jobs(Folder(tmp_path))  # noqa: S311 - the same each time
    page = TestClient(app(access, jobs), base_url=f"http://127.0.0.1:{PORT}")
    page.headers.update({"origin": f"http://127.0.0.1:{PORT}", "authorization": f"Bearer {access.key}"})
    with page:
        for case in range(cases):
            put(tmp_path, dice)
            kind = dice.randrange(3)
            if kind == 0:
                names = [one.name for one in tmp_path.iterdir() if one.name.isprintable()]
                query = {name: dice.choice([*TEXTS, *names]) for name in ("name", "kind", "first", "find", "backend")}
                answer = page.get(f"/api/{dice.choice(GET)}", params=query)
            else:
                table = json.dumps({name: dice.choice(ODD) for name in FIELDS if dice.random() < 0.7}).encode()
                path = dice.choice(["/api/start", "/api/preview", "/token", "/api/stop?press=%ff", "/api/acknowledge"])
                answer = page.post(path, content=table if kind == 1 else dice.choice(BODIES))
            assert answer.status_code in {200, 400, 403}, (case, answer.text)
            if case % 20 == 0:
                with page.websocket_connect(f"ws://127.0.0.1:{PORT}/api/stream") as stream:
                    stream.send_text(dice.choice([access.key, *TEXTS]))
                    stream.send_text(dice.choice(TEXTS))
    jobs.end()
    if cases > 1000:
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < most + 150e3  # KiB
