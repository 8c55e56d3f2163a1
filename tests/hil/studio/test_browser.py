"""The page in a real browser, with the command as a person starts it: from a stand to a number, and the stop."""

from __future__ import annotations

import gc
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from hil.api.recordings import load
from hil.studio.growing import Growing

from ...late_ticks import ALLOW
from ..hand.conftest import SIMULATED_HAND

if TYPE_CHECKING:
    from playwright.sync_api import FrameLocator, Locator, Page

pytestmark = pytest.mark.study

HIL = [sys.executable, "-c", "from hil.cli import main; main()"]
STUDIO = f"""{ALLOW}
from hil import child
from hil.cli import main
child._START = {ALLOW!r} + child._START
main()
"""
"""The command, with runs that no late tick ends."""
SOON = 120_000  # ms, on a busy machine
STAND = """
[stand]
name = "an emulated finger"
backend = "dynamixel"
motor_inertia = 3.2e-6
motor_damping = 1.6e-6
[limits]
torque = 0.06
deflection = 1.5
velocity = 60.0
temperature = 65.0
[dynamixel]
port = "{port}"
model = "xl330-m288"
reply_timeout = 0.3
watchdog = 1.0
"""


@contextmanager
def studio(folder: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """`hil studio` in a folder: its link, and its process."""
    words = [sys.executable, "-c", STUDIO, "studio", "--port", "0"]
    with subprocess.Popen(words, cwd=folder, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        try:
            yield re.findall(r"http://\S+", process.stderr.readline())[0], process
        finally:
            process.terminate()  # which asks a run to stop
            process.wait(30)


@contextmanager
def emulated(folder: Path, *words: str) -> Iterator[Path]:
    """An emulated drive and its stand file in a folder."""
    stand = folder / "finger.toml"
    stand.write_text(STAND.format(port=folder / "ttyDXL"))
    command = [*HIL, "emulate", "dynamixel", "--link", str(folder / "ttyDXL"), "--stand", str(stand), *words]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        process.stderr.readline()
        try:
            yield stand
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(30)


Opened = Callable[..., "Page"]


def nice(program: str, folder: Path) -> Path:
    """A program that starts `program` so that its many threads take no core from a drive that another test emulates."""
    script = folder / "nice"
    script.write_text(f'#!/bin/sh\nexec nice -n 10 "{program}" "$@"\n')
    script.chmod(0o755)
    return script


@pytest.fixture
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Opened]:
    """Open a page in a browser of its own; a fault of its scripts fails the test."""
    sync_playwright = pytest.importorskip("playwright.sync_api", reason="PAGE NOT OPENED: pip install 'hil[study]'")
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("PAGE NOT OPENED IN A BROWSER: there is no chromium; apt-get install chromium")
    program = nice(browser, tmp_path_factory.mktemp("browser"))
    faults: list[str] = []
    with ExitStack() as stack:
        driver = [stack.enter_context(sync_playwright.sync_playwright())]

        def begin(link: str, width: int = 1200, *, quiet: bool = True, **more: Any) -> Page:
            process = driver[0].chromium.launch(executable_path=program, args=["--no-sandbox"])
            stack.callback(process.close)
            page: Page = process.new_context(viewport={"width": width, "height": 900}, **more).new_page()
            page.set_default_timeout(SOON)
            page.on("pageerror", lambda error: faults.append(str(error)))
            page.on(
                "console", lambda one: faults.append(one.text) if quiet and "Content Security" in one.text else None
            )
            page.goto(link)
            page.wait_for_selector("#stands input", state="attached")  # a run that goes on is shown instead
            return page

        yield begin
    driver.clear()
    gc.collect()  # the threads of its event loop end with it, one of them when it has seen the driver's process end
    for thread in threading.enumerate():
        if thread.name.startswith("asyncio"):
            thread.join()
    assert faults == []


def shown(page: Page, wanted: Locator) -> None:
    """Wait until the page shows it. Fails as soon as the page says that a command failed, with what it says."""
    failure = page.locator("#said .error, #banner, [data-tone=bad] #state, [data-tone=bad] #more")
    wanted.or_(failure).filter(visible=True).first.wait_for()
    assert wanted.is_visible(), "\n".join(failure.all_inner_texts())


def begin(page: Page) -> None:
    """Start a run that goes on until it is stopped, however late a busy machine is."""
    page.fill("[name=duration]", "600")
    page.click("#start")


def begin_on_the_drive(page: Page) -> None:
    """Choose the emulated drive, start such a run, and say yes to the question."""
    page.locator("[value='finger.toml']").check()
    page.click("#to-record")
    begin(page)
    page.click("#yes")


def wait_for_rows(page: Page) -> None:
    """Wait until rows have come for a fifth of a second."""
    shown(page, page.locator("#figures", has_text=re.compile(r"Kc so far[\d.]")))


def stopped(page: Page) -> float:
    """Wait until the page says that the torque is off. Return after how long, ms."""
    shown(page, page.locator("#state", has_text="Torque off after"))
    return float(re.findall(r"after (\d+) ms", page.inner_text("#state"))[0])


def report(page: Page) -> FrameLocator:
    """Wait for the report of the recordings that are identified. Return its frame."""
    shown(page, page.locator("#report iframe"))
    return page.frame_locator("#report iframe")


def descendants(process: int) -> list[int]:
    """The processes that it started, and those that they started."""
    said = subprocess.run(["pgrep", "-P", str(process)], capture_output=True, text=True, check=False).stdout
    return [
        one for child in map(int, said.split()) for one in (child, *descendants(child)) if Path(f"/proc/{one}").exists()
    ]


@contextmanager
def frozen(processes: list[int]) -> Iterator[None]:
    for one in processes:
        os.kill(one, signal.SIGSTOP)
    try:
        yield
    finally:
        for one in processes:
            os.kill(one, signal.SIGCONT)


def wait_until(true: Callable[[], bool], pause: Callable[[], object] = lambda: time.sleep(0.01)) -> None:
    end = time.monotonic() + SOON / 1e3
    while not true():
        assert time.monotonic() < end
        pause()


def rows(part: Path) -> int:
    """How many rows a recording in progress has."""
    growing = Growing(part)
    growing.update()
    return int(growing.figures()["rows"])


def barriers(page: Page) -> list[Any]:
    """What axe-core finds."""
    package = find_spec("axe_core_python")
    assert package is not None
    assert package.origin is not None
    page.evaluate(Path(package.origin).with_name("axe.min.js").read_text(encoding="utf-8"))
    rules = "axe.run(document, { iframes: false })"  # of the report has a test of its own
    found = page.evaluate(f"{rules}.then((all) => all.violations.map((one) => [one.id, one.nodes[0].html]))")
    return list(found)


def test_the_joints_of_a_hand_are_recorded_one_after_the_other(opened: Opened, tmp_path: Path) -> None:
    (tmp_path / "hand.toml").write_text(SIMULATED_HAND)
    with studio(tmp_path) as (link, _):
        page = opened(link)
        page.check("input[value='hand.toml#soft']")
        page.click("#to-record")
        for joint in ("soft", "stiff"):
            page.locator("#chosen", has_text=f"bench hand: {joint}").wait_for()
            page.fill("[name=duration]", "5")
            page.locator("#predicted", has_text="predicted standard errors").wait_for()
            page.click("#start")
            shown(page, page.locator("#to-identify"))
            assert page.is_visible("#to-next") == (joint == "soft")
            if joint == "soft":
                assert barriers(page) == []
                page.click("#to-next")
        page.click("[data-step=stand]")
        page.check("input[value='hand.toml#soft']")
        page.click("#to-record")
        page.check("#row")
        for stopped in (True, False):  # STOP ends the row
            page.click("#start")
            page.locator("#state", has_text="Recording").wait_for()  # until then the figures are those of the last run
            wait_for_rows(page)
            if stopped:
                page.keyboard.press("Escape")
            page.locator("#predicted", has_text="run3.h5: " if stopped else "run5.h5: ").wait_for()
        shown(page, page.locator("#to-identify"))
    found = [load(tmp_path / f"recordings/run{number}.h5").truth["Kc"] for number in range(1, 6)]
    assert found == [0.015, 0.03, 0.015, 0.015, 0.03]


def test_from_an_empty_folder_to_a_report_in_three_clicks(opened: Opened, tmp_path: Path) -> None:
    with studio(tmp_path) as (link, _):
        page = opened(link)
        assert page.url.endswith("/#stand")  # the token is no longer in the address
        assert barriers(page) == []
        page.click("#to-record")
        page.locator("#predicted", has_text="predicted standard errors: Kc 0.").wait_for()
        assert barriers(page) == []
        page.click("#start")
        wait_for_rows(page)
        assert barriers(page) == []  # while it moves
        shown(page, page.locator("#to-identify"))
        page.click("#to-identify")
        found = report(page)
        found.locator("h1", has_text="recordings/run1.h5").wait_for()
        assert "Kc = 17." in found.locator(".verdict").inner_text()
        shown(page, page.locator("#recordings", has_text="Kc = 17."))
        assert barriers(page) == []
        assert page.inner_text("#trust") == "Kc and Bc can be trusted"
        assert re.search(r"Kc\s+17\.\d+ ± 0\.\d+ mN m/rad\s+95 %", page.inner_text("#values"))
        for again in (lambda: page.click("[data-step=record]"), page.reload):  # the normal second step of a person
            again()
            page.locator("#predicted", has_text="predicted standard errors").wait_for()
        page.fill("[name=duration]", "10")
        page.locator("#predicted", has_text=", 10 s").wait_for()
    assert {path.name for path in tmp_path.iterdir()} == {"recordings"}
    assert {path.name for path in (tmp_path / "recordings").iterdir()} == {"run1.h5", "run1.html"}


def test_an_emulated_drive_is_checked_read_asked_about_recorded_and_stopped(opened: Opened, tmp_path: Path) -> None:
    with emulated(tmp_path), studio(tmp_path) as (link, _):
        page = opened(link)
        page.locator("[value='finger.toml']").check()
        page.click("#readings")
        shown(page, page.locator("#reading", has_text=re.compile(r"motor.*rad.*torque at the joint.*N m", re.DOTALL)))
        page.click("#check")
        shown(page, page.locator("#checks", has_text="ok connection"))
        page.click("#commission")
        shown(page, page.locator("#asked", has_text="Lock the joint"))
        page.click("#no")
        page.click("#to-record")
        page.locator("#predicted", has_text="give “Kc, roughly”").wait_for()
        page.fill("[name=kc]", "17 mN*m/rad")
        page.fill("[name=bc]", "2e-4")
        page.locator("#predicted", has_text="predicted standard errors").wait_for()
        page.fill("[name=amplitude]", "10 mN*m")
        page.click("#start")
        page.locator("#asked", has_text="up to 10.0 mN m at the joint for 20.0 s").wait_for()
        page.keyboard.press("Enter")  # "No" has the focus: Enter, Enter starts no motor
        page.locator("#asked").wait_for(state="hidden")
        assert page.get_attribute("body", "data-moving") != "yes"
        begin(page)
        page.click("#yes")
        wait_for_rows(page)
        page.hover("#stop")
        page.mouse.down()  # which stops; letting go is no second stop
        assert stopped(page) > 90.0
        page.mouse.up()
        shown(page, page.locator("#predicted", has_text="(stopped on request)"))


def test_a_stand_file_is_written_its_drive_is_moved_and_the_best_excitation_is_found(
    opened: Opened, tmp_path: Path
) -> None:
    (tmp_path / "drive").mkdir()
    with emulated(tmp_path / "drive"), studio(tmp_path) as (link, _):
        page = opened(link)
        page.get_by_text("A new stand file for a drive").click()
        page.select_option("[name=backend]", "dynamixel")
        page.fill("[name='dynamixel.model']", "xl330-m288")
        page.fill("[name='stand.motor_inertia']", "3.2e-6")
        assert barriers(page) == []
        page.click("#write")
        page.locator("#banner", has_text="Fill in “Port”").wait_for()
        assert not re.search(r"dynamixel\.|stand\.|limits\.|--", page.inner_text("#new"))  # no keys, no options
        page.fill("[name='dynamixel.port']", str(tmp_path / "drive" / "ttyDXL"))
        page.click("#write")
        page.get_by_label("my stand").and_(page.locator(":checked")).wait_for()
        page.click("#move")
        page.locator("#asked", has_text="will move with up to 1.00 mN m at the joint for 3 s").wait_for()
        page.click("#yes")
        page.locator("#checks", has_text=re.compile("ok signs|error (move|lock)")).wait_for()
        page.click("#to-record")
        page.fill("[name=duration]", "5")
        page.click("#design")
        page.locator("#said .error", has_text="“Kc, roughly”").wait_for()
        page.fill("[name=kc]", "17 mN*m/rad")
        page.fill("[name=bc]", "2e-4")
        page.click("#design")
        page.locator("#state", has_text="Searching the best excitation").wait_for()
        page.locator("#state", has_text="Nothing moves").wait_for()
        page.locator("#predicted", has_text="predicted standard errors").wait_for()
        assert page.input_value("[name=band]")
        assert page.input_value("[name=duration]") == "5"


def test_any_key_stops_while_the_motor_moves(opened: Opened, tmp_path: Path) -> None:
    with studio(tmp_path) as (link, _):
        page = opened(link)
        page.click("#to-record")
        for key in ("Space", "Escape", "a", "End", "Enter", "Tab"):
            begin(page)
            shown(page, page.locator("#left", has_text=re.compile(r"5\d\d\.")))  # a second is over
            page.focus("[data-step=identify]" if key == "a" else "#stop" if key == "Enter" else "#whole")
            page.keyboard.press(key)
            assert stopped(page) > 90.0, key
            assert page.input_value("[name=duration]") == "600", key
            shown(page, page.locator("#predicted", has_text="(stopped on request)"))


def test_a_key_right_after_start_stops_too(opened: Opened, tmp_path: Path) -> None:
    with studio(tmp_path) as (link, _):
        page = opened(link)
        page.click("#to-record")
        begin(page)
        page.keyboard.press("Space")
        page.locator("#state", has_text="Stopped.").or_(page.locator("#banner", has_text="before it began")).wait_for()
        page.locator("body[data-moving=no]").wait_for()


def test_a_click_before_the_page_knows_its_stands_does_nothing(opened: Opened, tmp_path: Path) -> None:
    held: list[Any] = []
    with studio(tmp_path) as (link, _):
        page = opened(link)
        page.route("**/api/folder*", lambda route: held.extend([route]), times=1)
        page.reload()
        wait_until(lambda: bool(held), lambda: page.wait_for_timeout(10))
        for button in ("#to-record", "nav button[data-step=record]"):
            place = page.locator(button).bounding_box()
            assert place is not None
            page.mouse.click(place["x"] + place["width"] / 2.0, place["y"] + place["height"] / 2.0)
        held[0].continue_()
        page.click("#to-record")
        page.locator("#record").wait_for()


def test_a_key_that_overtakes_the_start_stops_the_run_that_then_begins(opened: Opened, tmp_path: Path) -> None:
    """The server hears of the key before the start; the page hears the answer to it before it hears of the run."""
    starts: list[Any] = []
    answers: list[tuple[Any, Any]] = []
    states: list[Callable[[], None]] = []

    def streamed(end: Any) -> None:
        end.connect_to_server().on_message(lambda sent: states.append(partial(end.send, sent)))

    with studio(tmp_path) as (link, _):
        page = opened(link)
        page.route_web_socket("**/api/stream", streamed)
        page.route("**/api/start", lambda route: starts.extend([route]))
        page.route("**/api/stop*", lambda route: answers.append((route, route.fetch())), times=1)
        page.reload()
        page.click("#to-record")
        begin(page)
        page.keyboard.press("Space")
        wait_until(lambda: bool(starts and answers), lambda: page.wait_for_timeout(10))
        with page.expect_response("**/api/start"):
            starts[0].continue_()
        answers[0][0].fulfill(response=answers[0][1])
        over = page.locator("#state", has_text=re.compile(r"Stopped|Torque off after"))

        def hear() -> None:
            page.wait_for_timeout(10)
            while states:
                states.pop(0)()

        wait_until(over.is_visible, hear)
        page.locator("body[data-moving=no]").wait_for()


def test_the_whole_way_is_possible_with_the_keyboard_alone_at_390_pixels_in_the_dark(
    opened: Opened, tmp_path: Path
) -> None:
    with studio(tmp_path) as (link, _):
        page = opened(link, width=390, color_scheme="dark")

        def reach(name: str) -> None:
            for _ in range(60):
                page.keyboard.press("Tab")
                if page.evaluate("document.activeElement.id || document.activeElement.name") == name:
                    return
            raise AssertionError(f"{name} cannot be reached with Tab")

        page.click("[data-step=stand]")
        reach("to-record")
        page.keyboard.press("Enter")
        reach("duration")
        page.keyboard.type("5")
        reach("start")
        page.keyboard.press("Space")
        wait_for_rows(page)
        box = page.locator("#stop").bounding_box()
        assert box is not None
        assert box["x"] + box["width"] <= 390
        shown(page, page.locator("#to-identify"))
        assert page.evaluate("document.activeElement.id") == "to-identify"
        page.keyboard.press("Enter")
        report(page).locator("h1", has_text="run1.h5").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_a_run_goes_on_when_its_page_is_closed_and_a_second_page_stops_it(opened: Opened, tmp_path: Path) -> None:
    with studio(tmp_path) as (link, process):
        page = opened(link)
        page.click("#to-record")
        begin(page)
        wait_for_rows(page)
        with page.expect_popup() as popup:
            page.evaluate("window.open('/')")  # which gets the key; another window needs a link
        second = popup.value
        page.close()
        wait_for_rows(second)
        second.click("#stop")
        assert stopped(second) > 90.0
        assert process.poll() is None


def test_a_run_goes_on_while_page_and_server_are_frozen_and_ends_where_the_whole_computer_sleeps(
    opened: Opened, tmp_path: Path
) -> None:
    log, part = tmp_path / "torque.csv", tmp_path / "recordings" / "run1.h5.part"
    with emulated(tmp_path, "--log", str(log)), studio(tmp_path) as (link, process):
        page = opened(link)
        begin_on_the_drive(page)
        wait_for_rows(page)
        browsers = [one for one in descendants(os.getpid()) if "chrom" in Path(f"/proc/{one}/comm").read_text()]
        with frozen([process.pid, *browsers]):
            before = rows(part)
            wait_until(lambda: rows(part) > before + 100)
        assert page.get_attribute("body", "data-moving") == "yes"
        with frozen([process.pid, *descendants(process.pid), *browsers]):  # all but the drive
            wait_until(lambda: log.read_text().splitlines()[-1].endswith(",tripped"))
        page.locator("#said .error").first.wait_for()
        page.locator("body[data-moving=no]").wait_for()
        assert log.read_text().splitlines()[-1].split(",")[2:5] == ["0", "0", "0"]


def test_a_run_survives_a_studio_that_is_killed_and_the_next_one_stops_it(opened: Opened, tmp_path: Path) -> None:
    with studio(tmp_path) as (link, process):
        page = opened(link)
        page.click("#to-record")
        begin(page)
        wait_for_rows(page)
        process.kill()
        page.locator("#more", has_text=re.compile(r"By the clock it ends at .*, in \d+ s, under its guard")).wait_for()
        page.keyboard.press("Space")
        page.locator("[data-tone=bad] #state", has_text="hil does not answer: cut the power").wait_for()
        with studio(tmp_path) as (again, _):
            other = opened(again)
            wait_for_rows(other)
            other.keyboard.press("Space")
            assert stopped(other) > 90.0
            other.locator("#state", has_text="Torque off").wait_for()


def test_ctrl_c_in_the_terminal_stops_the_run_and_then_ends_the_studio(opened: Opened, tmp_path: Path) -> None:
    with studio(tmp_path) as (link, process):
        page = opened(link)
        page.click("#to-record")
        begin(page)
        wait_for_rows(page)
        process.send_signal(signal.SIGINT)
        assert stopped(page) > 90.0
        assert process.poll() is None
        shown(page, page.locator("#predicted", has_text="(stopped on request)"))
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0


def test_a_drive_that_is_unplugged_ends_the_run_with_its_reason(opened: Opened, tmp_path: Path) -> None:
    with ExitStack() as stack:
        drive = ExitStack()
        stack.enter_context(drive)
        drive.enter_context(emulated(tmp_path))
        link, _ = stack.enter_context(studio(tmp_path))
        page = opened(link)
        begin_on_the_drive(page)
        wait_for_rows(page)
        drive.close()
        red = page.locator("[data-tone=bad] #more", has_text=re.compile("torque|drive|reply|link", re.IGNORECASE))
        red.wait_for()
        page.locator("body[data-moving=no]").wait_for()
        page.click("[data-step=identify]")
        page.reload()
        red.wait_for()
        assert barriers(page) == []
        page.click("#read")
        page.reload()
        page.locator("[data-tone=still] #state", has_text="Nothing moves.").wait_for()


def test_a_second_studio_on_the_same_stand_is_refused_with_the_first_ones_run(opened: Opened, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    with emulated(tmp_path) as stand, studio(tmp_path) as (link, _), studio(other) as (second, _):
        shutil.copy(stand, other)
        page = opened(link)
        begin_on_the_drive(page)
        wait_for_rows(page)
        rival = opened(second)
        begin_on_the_drive(rival)
        said = rival.locator("#said .error", has_text="in use by process").inner_text()
        assert re.search(r"in use by process \d+ \(python\S* hil record --stand=finger.toml ", said)
        assert rival.get_attribute("body", "data-moving") == "no"
        assert page.get_attribute("body", "data-moving") == "yes"
        page.keyboard.press("Space")
        assert stopped(page) > 90.0


def test_two_recordings_lie_over_each_other_and_a_window_is_dragged(opened: Opened, tmp_path: Path) -> None:
    for name in ("one", "two"):
        words = [*HIL, "record", "--backend", "sim", "--duration", "4", "--seed", str(len(name)), "-o", f"{name}.h5"]
        subprocess.run(words, cwd=tmp_path, check=True, capture_output=True)
    with studio(tmp_path) as (link, _):
        page = opened(link)
        page.click("[data-step=identify]")
        page.get_by_label("choose one.h5").check()
        page.get_by_label("choose two.h5").check()
        page.locator("#trace-plot .u-legend", has_text="two.h5").wait_for()
        over = page.locator("#trace-plot .u-over").bounding_box()
        assert over is not None
        middle = over["y"] + over["height"] / 2.0
        page.mouse.move(over["x"] + 0.25 * over["width"], middle)
        page.mouse.down()
        page.mouse.move(over["x"] + 0.75 * over["width"], middle)
        page.mouse.up()
        assert float(page.input_value("#from")) == pytest.approx(1.0, abs=0.05)
        assert float(page.input_value("#to")) == pytest.approx(3.0, abs=0.05)
        page.click("#zoom")
        page.fill("#find", "nothing")
        page.locator("#count", has_text="no recording").wait_for()
        page.reload()
        page.locator("#picked li").nth(1).wait_for()  # a search and a reload keep the choice
        assert page.input_value("#find") == "nothing"
        page.fill("#find", "")
        page.click("#compare")
        report(page).locator("h1").wait_for()
        page.locator("#trust", has_text="The recordings").wait_for()
        assert "Kc" in page.inner_text("#because")
        page.get_by_label("choose two.h5").uncheck()
        for stale in ("#report", "#result", "#exported"):  # of another choice
            page.locator(stale).wait_for(state="hidden")
        (tmp_path / "two.h5").unlink()
        page.get_by_label("choose two.h5").press("Space")
        page.locator("#banner", has_text="'two.h5' is no file of this folder any more").wait_for()
        page.locator("#count", has_text="of 1,").wait_for()


def test_a_read_only_folder_and_a_stranger_are_refused_with_a_sentence(opened: Opened, tmp_path: Path) -> None:
    with studio(tmp_path) as (link, _):
        page = opened(link)
        (tmp_path / "recordings").write_text("a file in the place of the folder")
        page.click("#to-record")
        page.click("#start")
        page.locator("#banner, #said .error", has_text="cannot be written").first.wait_for()
        stranger = page.context.browser.new_page()  # type: ignore[union-attr]
        stranger.goto(link.partition("#")[0] + "#wrong")
        stranger.locator("#banner", has_text="this link was used before").wait_for()


HOSTILE = """<title>a.h5: Kc = 1</title><link rel=prefetch href="{away}/prefetch"><img src="{away}/image"><h1>here</h1>
<meta http-equiv=refresh content="1; {away}/itself"><style>h1 {{ background: url({away}/style) }}</style><script>
fetch("{away}/fetch"); const peer = new RTCPeerConnection({{ iceServers: [{{ urls: "stun:127.0.0.1:{port}" }}] }});
peer.createDataChannel("x"); peer.setLocalDescription();
</script>"""


def test_a_report_in_the_page_and_in_a_window_of_its_own_sends_nothing_away(opened: Opened, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as elsewhere, studio(tmp_path) as (link, _):
        port = elsewhere.getsockname()[1]
        heard = socket.socket(type=socket.SOCK_DGRAM)
        heard.bind(("127.0.0.1", port))
        (tmp_path / "a.html").write_text(HOSTILE.format(away=f"http://127.0.0.1:{port}", port=port))
        page = opened(link, quiet=False)
        frame = "Object.assign(document.createElement('iframe'), { sandbox: 'allow-scripts', src })"
        page.evaluate(f"Link.address('report', 'a.html').then((src) => document.body.append({frame}))")
        with page.expect_popup() as popup:
            page.evaluate("Link.openReport('a.html')")
        for window in (page, popup.value):
            wait_until(lambda shown=window: "error" in shown.frames[-1].url, lambda: page.wait_for_timeout(10))  # type: ignore[misc]
        elsewhere.settimeout(0.0)
        heard.settimeout(0.0)
        with heard, pytest.raises(BlockingIOError):
            heard.recv(100)
        with suppress(BlockingIOError):
            while connection := elsewhere.accept()[0]:  # a browser may connect before it asks whether it may
                with connection, suppress(BlockingIOError):
                    connection.setblocking(False)
                    assert connection.recv(100) == b""


def cut(page: Page) -> list[str]:
    """What is wider than its place, of the window and of all elements that are in view."""
    found = """(one) => one.getBoundingClientRect().right > innerWidth + 1
        || one.scrollWidth > one.clientWidth + 1 && one.clientWidth > 0 && !one.closest('.uplot, input, meter')
        || one.placeholder && one.scrollWidth > one.clientWidth"""
    shown = "[...document.querySelectorAll('html, body *')].filter((one) => one.checkVisibility())"
    return list(page.evaluate(f"{shown}.filter({found}).map((one) => one.outerHTML.slice(0, 120))"))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_cut_and_axe_finds_nothing_at_any_width(opened: Opened, tmp_path: Path, scheme: str) -> None:
    long = "a_very_long_name_" * 9
    (tmp_path / f"{long}.h5").touch()
    answer = "Kc = 17.78 ± 0.05 mN m/rad,  Bc = 0.190 ± 0.003 mN m s/rad  (95 %)"
    (tmp_path / f"{long}.html").write_text(f"<title>{long}.h5: {answer}</title>")
    (tmp_path / "bad.toml").write_text(f"[stand]\ngear = 3\nname = '{long}'\n")
    with studio(tmp_path) as (link, _):
        page = opened(link, color_scheme=scheme)
        red = page.locator("#stands .error").evaluate("(one) => getComputedStyle(one).color")
        assert red == {"light": "rgb(180, 35, 24)", "dark": "rgb(255, 143, 135)"}[scheme]
        page.get_by_text("A new stand file for a drive").click()
        page.select_option("[name=backend]", "dynamixel")
        page.locator("[name='limits.torque']").wait_for()
        for width in (390, 1280, 1920):
            page.set_viewport_size({"width": width, "height": 900})
            for step in ("stand", "record", "identify"):
                page.click(f"[data-step={step}]")
                page.evaluate(f"document.querySelector('#{step} .line').open = true")
                page.locator(f"#{step} code", has_text=re.compile("hil|choose")).wait_for()
                page.locator("#predicted:visible", has_text="predicting").wait_for(state="hidden")
                assert (barriers(page), cut(page)) == ([], []), (width, step)
            assert page.locator(".answer").evaluate("(one) => one.clientHeight") < 80  # not letter by letter
        page.get_by_label(f"choose {long}.h5").click()  # the page takes the choice back, since the file is empty
        page.locator("#banner").wait_for()
        assert (barriers(page), cut(page)) == ([], [])


def test_a_frozen_server_is_said_in_red_after_a_second_and_the_command_beside_it_stops_the_run(
    opened: Opened, tmp_path: Path
) -> None:
    with studio(tmp_path) as (link, process):
        page = opened(link)
        page.click("#to-record")
        begin(page)
        wait_for_rows(page)
        with frozen([process.pid]):
            page.keyboard.press("Space")
            page.locator("[data-tone=bad] #state", has_text="hil does not answer: cut the power").wait_for()
            assert (barriers(page), cut(page)) == ([], [])
            assert not page.is_visible("#clock")  # which would show the last that was known
            words = page.inner_text("#rescue-line")
            assert re.fullmatch(r"kill -INT \d+", words)
            subprocess.run(words.split(), check=True)
            wait_until((tmp_path / "recordings" / "run1.h5").exists)
        page.locator("[data-tone=still] #state").wait_for()


def test_a_server_that_ends_while_nothing_moves_is_no_run_that_goes_on(opened: Opened, tmp_path: Path) -> None:
    with studio(tmp_path) as (link, process):
        page = opened(link)
        page.click("#to-record")
        page.fill("[name=duration]", "2")
        page.click("#start")
        shown(page, page.locator("#to-identify"))
        process.kill()
        page.locator("#state", has_text="Connection lost, nothing was moving").wait_for()
        assert not page.is_visible("#rescue")


def test_a_run_that_begins_elsewhere_takes_a_shown_report_and_a_question_away_so_that_keys_stop_it(
    opened: Opened, tmp_path: Path
) -> None:
    (tmp_path / "a.h5").touch()
    (tmp_path / "a.html").write_text("<title>a.h5: Kc = 1</title><p>text</p>")
    start = "Link.ask('/api/start', {kind: 'record', stand: 'sim', duration: '600'})"  # as another window does
    with emulated(tmp_path), studio(tmp_path) as (link, _):
        page = opened(link)
        page.click("[data-step=identify]")
        page.click("text=Show")
        page.frame_locator("#report iframe").locator("p").click()  # the frame has the focus now
        page.evaluate(start)
        wait_for_rows(page)
        assert page.locator("iframe").count() == 0
        page.keyboard.press("x")
        assert stopped(page) > 90.0
        page.locator("body[data-moving=no]").wait_for()
        page.click("[data-step=stand]")
        page.locator("[value='finger.toml']").check()
        page.click("#move")
        page.locator("#question").wait_for()
        page.evaluate(start)
        wait_for_rows(page)
        page.locator("#question").wait_for(state="hidden")
        page.click("#stop")
        assert stopped(page) > 90.0


def full(end: Any) -> None:
    """Let the server say that the disk has 4 kB free."""
    end.connect_to_server().on_message(
        lambda sent: end.send(sent if isinstance(sent, bytes) else json.dumps(json.loads(sent) | {"free": 4096}))
    )


def test_back_and_reload_keep_step_stand_and_form_and_a_full_disk_is_said(opened: Opened, tmp_path: Path) -> None:
    with emulated(tmp_path), studio(tmp_path) as (link, _):
        page = opened(link)
        page.locator("[value='finger.toml']").check()
        page.click("#to-record")
        page.fill("[name=duration]", "7")
        page.click("[data-step=identify]")
        page.go_back()
        page.locator("#record").wait_for()
        page.route_web_socket("**/api/stream", full)
        page.reload()
        page.locator("#space.error", has_text="The disk is full").wait_for()
        assert page.input_value("[name=duration]") == "7"
        assert page.inner_text("#chosen") == "an emulated finger"
        page.go_back()
        page.locator("#stand").wait_for()
        assert page.locator("[value='finger.toml']").is_checked()
