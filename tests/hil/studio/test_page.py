"""The answers of the page: what its folder holds, what it starts, and what it refuses."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="PAGE NOT TESTED: pip install 'hil[studio]'")

from starlette.testclient import TestClient

from hil.api.runs import record
from hil.errors import WrongUse
from hil.recording.reader import Recording
from hil.studio.commands import line_of
from hil.studio.folder import Folder
from hil.studio.guard import Access
from hil.studio.jobs import Jobs
from hil.studio.server import app, bind

from ..conftest import Maker, copied, exit_status

PORT = 8455
PAGE = {"origin": f"http://127.0.0.1:{PORT}", "sec-fetch-site": "same-origin"}


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[TestClient]:
    """A browser that has opened the link."""
    monkeypatch.chdir(tmp_path)
    access = Access(PORT)
    jobs = Jobs(Folder(tmp_path))
    client = TestClient(app(access, jobs), base_url=f"http://127.0.0.1:{PORT}", headers=PAGE)
    assert client.get("/api/folder").status_code == 401
    token = access.link().partition("#")[2]
    assert [client.post("/token", json={"token": one}).status_code for one in ("x", token, token)] == [403, 200, 403]
    cookie = next(iter(client.cookies.jar))
    assert (cookie.has_nonstandard_attr("HttpOnly"), cookie.get_nonstandard_attr("SameSite")) == (True, "strict")
    with client:
        yield client
    jobs.end()
    for thread in threading.enumerate():
        if thread.name.startswith("AnyIO"):  # it ends with the client, but nobody waits for it
            thread.join()


def refused(page: TestClient, path: str, sent: dict[str, Any]) -> str:
    answer = page.post(path, json=sent)
    assert answer.status_code == 400
    return str(answer.json()["refused"])


def test_the_simulated_stand_is_there_from_the_first_start(page: TestClient) -> None:
    table = page.get("/api/folder").json()
    assert [(one["file"], one["simulated"]) for one in table["stands"]] == [("sim", True)]
    assert (table["recordings"], table["count"]) == ([], 0)
    assert "chirp" in table["profiles"]


def test_the_page_asks_what_a_stand_file_needs_and_proposes_what_is_known(page: TestClient) -> None:
    asked = {one["key"]: one for one in page.get("/api/questions?backend=dynamixel").json()}
    assert asked["dynamixel.port"]["default"] is None
    assert "xl330-m288" in asked["dynamixel.model"]["known"]
    assert asked["limits.torque"]["default"] == 0.02
    assert "unknown" in page.get("/api/questions?backend=x").json()["refused"]


def test_a_stand_file_with_an_error_is_shown_with_its_reason(page: TestClient, tmp_path: Path) -> None:
    (tmp_path / "good.toml").write_text(
        '[stand]\nname = "</b>"\nbackend = "sim"\n[limits]\ntorque = 0.01\ndeflection = 1\nvelocity = 1\n'
    )
    (tmp_path / "bad.toml").write_text("[stand]\ngear = 3\n")
    (tmp_path / "pyproject.toml").write_text("[tool.x]\na = 3\n")
    stands = page.get("/api/folder").json()["stands"]
    assert [one["name"] for one in stands] == ["simulated index finger, the paper's joint", "bad.toml", "</b>"]
    assert "stand.gear" in stands[1]["wrong"]


@pytest.mark.study
def test_thousands_of_recordings_are_listed_a_page_at_a_time_newest_first(page: TestClient, tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    for number in range(10_000):
        os.close(os.open(tmp_path / "recordings" / f"run{number}.h5", os.O_CREAT))
    os.utime(tmp_path / "recordings" / "run77.h5", (2e9, 2e9))
    (tmp_path / "recordings" / "run77.html").write_text("<title>run77.h5: Kc = 17.75 &#177; 0.06</title>")
    table = page.get("/api/folder").json()
    assert (table["count"], len(table["recordings"])) == (10_000, 50)
    first = table["recordings"][0]
    assert (first["file"], first["answer"], first["report"]) == (
        "recordings/run77.h5",
        "Kc = 17.75 ± 0.06",
        "recordings/run77.html",
    )
    (tmp_path / "recordings" / "\udcff.h5").touch()  # a name that is no text cannot be asked for
    assert page.get("/api/folder?find=RUN99&first=10").json()["count"] == 111
    assert page.get("/api/folder?find=run99&first=10").json()["recordings"][0]["answer"] == ""


def test_a_trace_is_the_recordings_and_one_that_was_deleted_is_refused(page: TestClient, make_recording: Maker) -> None:
    path = make_recording(samples=400)
    data = page.get("/api/trace?name=a.h5").content
    first, count, begin = struct.unpack("<IId", data[:16])
    values = np.frombuffer(data[16:], "<f4").reshape(4, count)
    with Recording(path) as recording:
        np.testing.assert_allclose(values[0] + begin, recording.channel("time"), atol=1e-6)
        np.testing.assert_allclose(values[3], recording.channel("dtheta"), rtol=1e-6)
    assert first == 0
    path.unlink()
    answer = page.get("/api/trace?name=a.h5")
    assert (answer.status_code, "was removed or renamed" in answer.json()["refused"]) == (400, True)


def test_no_file_outside_the_folder_is_read(page: TestClient, tmp_path: Path) -> None:
    (tmp_path / "link.html").symlink_to("/etc/hostname")
    for name in ("../x", "/etc/passwd", "link.html", "", ".", "a\0b"):
        assert page.get("/api/file", params={"name": name}).status_code == 400


def test_a_report_is_shut_off_from_the_page(page: TestClient, tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text("<title>a.h5: Kc</title>")
    answer = page.get("/api/report?name=a.html")
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts;")
    assert "allow-same-origin" not in policy


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ({"kind": "shell"}, "unknown command"),
        ({"kind": "record", "stand": "no.toml"}, "no file of this folder"),
        ({"kind": "record", "stand": "sim", "note": "a\x1b[2J"}, "note"),
        ({"kind": "identify", "recordings": []}, "choose one recording"),
        ({"kind": "compare", "recordings": ["a.h5"]}, "choose 2 to 20 recordings"),
        ({"kind": "export", "recordings": ["a.h5"], "suffix": ".sh"}, "unknown format"),
        ({"kind": "stand", "file": "../x.toml", "answers": {}}, "a name for a file of this folder"),
        ({"kind": "stand", "file": "x.toml", "answers": []}, "a name for a file of this folder"),
        ({}, "unknown command"),
    ],
)
def test_what_cannot_be_started_is_refused_with_its_reason(
    page: TestClient, make_recording: Maker, wanted: dict[str, Any], words: str
) -> None:
    make_recording(samples=10)
    assert words in refused(page, "/api/start", wanted)


def test_a_request_that_is_no_json_object_or_too_long_is_refused(page: TestClient) -> None:
    for data in (b"", b"[]", b"{", b"[" * 60_000, b" " * 70_000):
        assert page.post("/api/start", content=data).status_code == 400


def test_no_text_of_the_page_becomes_an_option_of_a_command(make_recording: Maker, tmp_path: Path) -> None:
    make_recording("--force.h5", samples=10)
    folder = Folder(tmp_path)
    wanted = {"kind": "record", "stand": "sim", "amplitude": "--no-guardian", "note": "--force", "yes": "true"}
    stand = {"kind": "stand", "backend": "sim", "file": "-f.toml", "answers": {"--force": "1"}}
    words = [*line_of(wanted, folder).words, *line_of(stand, folder).words]
    assert {"--amplitude=--no-guardian", "--note=--force", "--set=--force=1", "--output=-f.toml"} <= set(words)
    assert not {"--no-guardian", "--force", "-f.toml"} & set(words)
    assert "--yes" not in line_of(wanted, folder).words
    assert "./--force.h5" in line_of({"kind": "identify", "recordings": ["--force.h5"]}, folder).words


def test_a_report_that_hil_did_not_write_is_not_replaced(make_recording: Maker, tmp_path: Path) -> None:
    make_recording(samples=10)
    wanted, page = {"kind": "identify", "recordings": ["a.h5"], "from": "2", "to": "18"}, tmp_path / "a.html"
    assert {"--from=2", "--to=18"} <= set(line_of(wanted, Folder(tmp_path)).words)
    page.write_text("<title>my own page</title>")
    assert "--force" not in line_of(wanted, Folder(tmp_path)).words
    page.write_text("<title>a.h5: Kc = 1</title>")
    assert "--force" in line_of(wanted, Folder(tmp_path)).words


def test_no_command_takes_a_drive_from_readings_that_still_hold_its_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); print(1, flush=True)"
    monkeypatch.setattr("hil.studio.jobs.command", lambda *_: [sys.executable, "-c", f"{slow}; time.sleep(60)"])
    monkeypatch.setattr("hil.studio.jobs._ENDING", 0.01)
    jobs = Jobs(Folder(tmp_path))
    readings = jobs.start({"kind": "readings", "stand": "sim"})
    while readings.state()["answer"] is None:
        time.sleep(0.01)
    with pytest.raises(WrongUse, match="have not closed their link"):
        jobs.start({"kind": "doctor", "stand": "sim"})
    assert readings.state()["status"] is None
    assert isinstance(readings._process, subprocess.Popen)
    readings._process.kill()
    jobs.end()


def test_a_port_that_is_taken_is_said_before_anything_starts() -> None:
    with bind(0) as first, pytest.raises(WrongUse, match="--port"):
        bind(first.getsockname()[1])


@pytest.mark.usefixtures("busy_machine")
def test_a_run_that_another_program_started_is_shown_and_stopped_softly(page: TestClient, tmp_path: Path) -> None:
    """A studio that was killed, or a terminal: the recorder goes on, and any page of the folder stops it."""

    def run() -> int:
        return record("sim", duration=30.0, fade=0.1, realtime=True, output=tmp_path / "a.h5").outcome.signal

    child = copied(run)
    begun = time.monotonic()
    while not (tmp_path / "a.h5.part").exists() and time.monotonic() < begun + 60.0:
        time.sleep(0.01)
    states: list[dict[str, Any]] = []
    rows = 0
    assert page.post("/api/stop?press=0.5").json() == {"running": False}  # too early, and again below
    page.get("/api/folder")
    cookie = "; ".join(f"{one.name}={one.value}" for one in page.cookies.jar)
    with page.websocket_connect(f"ws://127.0.0.1:{PORT}/api/stream", headers={"cookie": cookie}) as stream:
        while not states or states[-1]["status"] is None:
            message = stream.receive()
            if "text" in message:
                states.append(json.loads(message["text"]))
                continue
            first, count, _ = struct.unpack("<IId", message["bytes"][:16])
            assert first == rows
            rows += count
            if rows == count:
                assert "is running" in refused(page, "/api/start", {"kind": "identify"})
                stream.send_text("0.5")  # a press of STOP comes in two ways, and a second stop would not ramp down
                assert page.post("/api/stop?press=0.5").json() == {"running": True}
    assert exit_status(child) == 2  # SIGINT
    assert states[-1]["off_after"] > 0.09  # the torque ramps down over 0.1 s
    assert states[-1]["live"]["rows"] == rows
    with Recording(tmp_path / "a.h5") as recording:
        assert [event.code for event in recording.events()] == ["stop-requested", "torque-off"]
        assert len(recording) == rows
