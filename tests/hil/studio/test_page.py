"""The answers of the page: what its folder holds, what it starts, and what it refuses."""

from __future__ import annotations

import json
import math
import os
import re
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
from hil.studio.preview import preview
from hil.studio.server import _text, app, bind

from ..conftest import Maker, copied, exit_status
from ..hand.conftest import SIMULATED_HAND

PORT = 8455
PAGE = {"origin": f"http://127.0.0.1:{PORT}", "sec-fetch-site": "same-origin"}


@pytest.fixture
def threads_end() -> Iterator[None]:
    """Those of AnyIO end with the client, but nobody waits for them."""
    yield
    for thread in threading.enumerate():
        if thread.name.startswith("AnyIO"):
            thread.join()


@pytest.fixture
def page(threads_end: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[TestClient]:
    """A browser that has opened the link."""
    del threads_end  # it is their end that is waited for
    monkeypatch.chdir(tmp_path)
    access = Access(PORT)
    jobs = Jobs(Folder(tmp_path))
    client = TestClient(app(access, jobs), base_url=f"http://127.0.0.1:{PORT}", headers=PAGE)
    assert client.get("/api/folder").status_code == 401
    token = access.link().partition("#")[2]
    answers = [client.post("/token", json={"token": one}) for one in ("x", token, token)]
    assert [one.status_code for one in answers] == [403, 200, 403]
    assert not client.cookies  # a browser would send one to the servers of other users on this computer
    client.headers["authorization"] = f"Bearer {answers[1].json()['key']}"
    with client:
        yield client
    jobs.end()


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


def test_only_regular_files_of_the_folder_are_listed_and_read(page: TestClient, make_recording: Maker) -> None:
    folder = make_recording(samples=10).parent
    outside = folder.with_name(f"{folder.name}-outside")
    outside.mkdir()
    (outside / "far.h5").touch()
    (outside / "s.toml").write_text("[stand]\ngear = 3\n")
    for number, target in enumerate(["/dev/zero", "gone", str(outside / "far.h5"), str(outside / "s.toml"), "/etc"]):
        for suffix in (".toml", ".h5", ".html", ".h5.part"):
            (folder / f"link{number}{suffix}").symlink_to(target)
    (folder / "within.h5").symlink_to("a.h5")
    (folder / "linked").symlink_to(outside)
    (folder / ".#editor.toml").symlink_to("me@here.1:2")
    (folder / "folder.toml").mkdir()
    for name in ("pipe.toml", "pipe.h5", "a.html", "pipe.h5.part"):
        os.mkfifo(folder / name)
    for odd in (b"\xff.h5", b"\xff.toml"):
        Path(os.fsdecode(os.path.join(os.fsencode(folder), odd))).write_text("[stand]\ngear = 3\n")  # noqa: PTH118
    table = page.get("/api/folder").json()
    assert [one["file"] for one in table["stands"]] == ["sim"]
    assert {one["file"] for one in table["recordings"]} == {"a.h5", "within.h5"}
    assert [one["report"] for one in table["recordings"]] == ["", ""]
    for name in ["../x", "/etc/passwd", "", ".", "a\0b", "linked/far.h5", *(one.name for one in folder.iterdir())]:
        if name in {"a.h5", "within.h5"} or not name.isprintable():
            continue
        for path in ("/api/ticket", "/api/trace"):
            assert page.get(path, params={"name": name}).status_code == 400, name
        assert "no file of this folder" in refused(page, "/api/start", {"kind": "doctor", "stand": name})
    (folder / "recordings").symlink_to(outside)
    assert "writes no file outside" in refused(page, "/api/start", {"kind": "record", "stand": "sim"})


def test_a_number_that_json_does_not_have_is_null() -> None:
    assert _text([math.nan, math.inf, 1.5]) == "[null, null, 1.5]"


@pytest.mark.usefixtures("threads_end")
def test_a_folder_whose_name_is_not_utf_8_is_shown(tmp_path: Path) -> None:
    (folder := tmp_path / "\udcff").mkdir()
    access = Access(PORT)
    client = TestClient(app(access, Jobs(Folder(folder))), base_url=f"http://127.0.0.1:{PORT}", headers=PAGE)
    with client:
        answer = client.get("/api/folder", headers={"authorization": f"Bearer {access.key}"})
    assert answer.json()["folder"] == str(folder.resolve())


def test_a_report_is_shut_off_from_the_page_and_shown_in_a_frame_only(page: TestClient, tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text("<title>a.h5: Kc</title>")
    address = page.get("/api/ticket?kind=report&name=a.html").json()["address"]
    del page.headers["authorization"]
    answer = page.get(address, headers={"sec-fetch-dest": "iframe"})
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts; default-src 'none';")
    assert "allow-same-origin" not in policy
    assert page.get(address, headers={"sec-fetch-dest": "document"}).status_code == 403
    assert page.get("/ticket/x").status_code == 400


def test_an_alarm_stays_until_it_is_acknowledged_and_nothing_moves_before(
    page: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    cry = "import sys; sys.exit('hil: CUT THE POWER: the torque-off is not confirmed')"
    with monkeypatch.context() as patched:
        patched.setattr("hil.studio.jobs.command", lambda *_: [sys.executable, "-c", cry])
        assert page.post("/api/start", json={"kind": "design", "stand": "sim"}).status_code == 200
    with page.websocket_connect(f"ws://127.0.0.1:{PORT}/api/stream") as stream:
        stream.send_text(page.headers["authorization"].removeprefix("Bearer "))

        def message() -> dict[str, Any]:
            return dict(json.loads(stream.receive_text()))

        while (state := message())["status"] is None:
            pass
        assert "CUT THE POWER" in state["alarm"]
        assert state["free"] > 0
        first = state["number"]
        assert "CUT THE POWER" in refused(page, "/api/start", {"kind": "record", "stand": "sim"})
        assert page.post("/api/start", json={"kind": "design", "stand": "sim"}).status_code == 200
        while (state := message())["number"] == first:
            pass
        assert "CUT THE POWER" in state["alarm"]
        page.post("/api/acknowledge")
        while message()["alarm"]:
            pass


def test_a_run_that_is_too_long_to_be_predicted_is_said_to_be_and_has_a_bounded_curve() -> None:
    found = preview("sim", {"duration": "1e9"})
    assert "too long to be predicted" in found["said"]
    assert 0 < len(found["curves"]["time"]) < 30_000


@pytest.mark.study
def test_a_preview_of_a_run_of_any_length_takes_little_memory_and_time() -> None:
    # ru_maxrss of a process is at least that of the one it was forked from
    code = "import resource; from hil.studio.preview import preview; import json, sys; from pathlib import Path\n"
    code += "for duration in sys.argv[1:]:\n f = preview('sim', {'duration': duration})\n"
    code += " own = Path('/proc/self/status').read_text()\n print(json.dumps([f.get('said', ''), "
    code += "len(f['curves']['time']), int(own.split('VmHWM:')[1].split()[0]), "
    code += "resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss]))"
    program = [sys.executable, "-c", code]
    assert "said" not in preview("sim", {"duration": "20"})  # which may have to compile, and keeps that
    durations = {"20": "", "100000": "too long to be predicted", "1e9": "too long"}
    out = subprocess.run([*program, *durations], capture_output=True, check=True).stdout
    for words, line in zip(durations.values(), out.splitlines(), strict=True):
        said, points, *sizes = json.loads(line)
        assert words in said
        assert bool(words) == bool(said)
        assert 0 < points < 30_000
        assert max(sizes) < 300e3  # KiB


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


def test_each_joint_of_a_hand_is_a_stand_and_names_the_joint_that_follows(page: TestClient, tmp_path: Path) -> None:
    (tmp_path / "hand.toml").write_text(SIMULATED_HAND)
    (tmp_path / "wrong.toml").write_text(SIMULATED_HAND.replace("deflection = 1.0", "deflection = -1.0"))
    _, soft, stiff, wrong = page.get("/api/folder").json()["stands"]
    assert (soft["name"], soft["next"]) == ("bench hand: soft", stiff["file"])
    assert (stiff["name"], stiff["next"]) == ("bench hand: stiff", "")
    assert "deflection" in wrong["wrong"]
    for kind, place in (("record", "--stand=hand.toml"), ("doctor", "hand.toml"), ("design", "--stand=hand.toml")):
        words = line_of({"kind": kind, "stand": stiff["file"]}, Folder(tmp_path)).words
        assert {place, "--joint=stiff"} <= set(words)
    assert preview("hand.toml", {"duration": "1"}, "stiff")["limits"]["torque"]["limit"] == 0.03
    assert "unknown joint 'soff'" in page.post("/api/preview", json={"stand": "hand.toml#soff"}).json()["refused"]


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
    answers: list[dict[str, Any]] = []
    rows = 0
    assert page.post("/api/stop?press=0.5").json() == {"press": "0.5", "running": False}  # too early, and again below
    page.get("/api/folder")
    with page.websocket_connect(f"ws://127.0.0.1:{PORT}/api/stream") as stream:
        stream.send_text(page.headers["authorization"].removeprefix("Bearer "))
        while not states or states[-1]["status"] is None:
            message = stream.receive()
            if "text" in message:
                given = json.loads(message["text"])
                (states if "number" in given else answers).append(given)
                continue
            first, count, _ = struct.unpack("<IId", message["bytes"][:16])
            assert first == rows
            rows += count
            if rows == count:
                assert "is running" in refused(page, "/api/start", {"kind": "identify"})
                stream.send_text("0.5")  # a press of STOP comes in two ways, and a second stop would not ramp down
                assert page.post("/api/stop?press=0.5").json() == {"press": "0.5", "running": True}
    assert exit_status(child) == 2  # SIGINT
    assert answers == [{"press": "0.5", "running": True}]
    assert states[-1]["off_after"] > 0.09  # the torque ramps down over 0.1 s
    assert states[-1]["live"]["rows"] == rows
    with Recording(tmp_path / "a.h5") as recording:
        assert [event.code for event in recording.events()] == ["stop-requested", "torque-off"]
        assert len(recording) == rows


def test_the_page_shows_the_command_line_that_a_click_would_run(page: TestClient) -> None:
    wanted = {"kind": "record", "stand": "sim", "duration": "5 s", "note": "a b"}
    said = page.post("/api/line", json=wanted).json()["command"]
    assert said.startswith("hil record --backend=sim '--duration=5 s' '--note=a b' --output=recordings/run1.h5")
    assert "choose one recording" in refused(page, "/api/line", {"kind": "identify", "recordings": []})


def test_the_page_is_told_which_process_a_terminal_can_stop(tmp_path: Path) -> None:
    jobs = Jobs(Folder(tmp_path))
    assert jobs.start({"kind": "doctor", "stand": "sim"}).state()["process"] > 1
    jobs.end()


def test_the_scripts_name_only_what_the_page_has_and_stay_small() -> None:
    static = Path(app.__code__.co_filename).with_name("static")
    shell = (static / "index.html").read_text()
    scripts = {path.name: path.read_text() for path in static.glob("*.js")}
    named = {name for text in scripts.values() for name in re.findall(r'at\("([\w-]+)"\)', text)}
    made = {"rescue-line", "left"}  # by band.js
    assert {name for name in named if f'id="{name}"' not in shell} <= made
    assert all(f'src="/static/{name}"' in shell for name in scripts)
    assert '<button type="button" id="no" autofocus>' in shell  # Enter, Enter starts no motor
    assert sum(len(text.splitlines()) for text in scripts.values()) <= 800
