"""Measure the page of hil studio: python benchmarks/studio.py (needs hil[studio,study] and chromium)

Prints a table and renews its parts in benchmarks/results/studio.csv:

- stop: beside busy loops, from the press in the browser, by its input event, to the moment at which an emulated
  DYNAMIXEL, on its serial line, has its torque off, by the emulator's own log; and to the first text of the band after
  "STOP sent", an answer or the alarm. Clicks and keys take turns, the keys with the focus on one thing after the other.
  0.1 s is the ramp; most of the rest is spent waiting for a core, so that the rows name the load. All runs are of one
  page. It starts them with the request that its button sends, as the prediction before would take most of the time.
- what the page costs: ticks missed at 500 Hz in `hil record` alone and with the page open, in turns; processor time of
  the server and of the browser during the run; frames of traces that the browser receives.
- first paint, and the page with its stands.
- the pictures of README and docs/studio.md, drawn anew into docs/pictures (--only pictures), and their sizes.
- an hour at 1 kHz: 3.6 million rows are written into a recording as fast as this computer can; the JavaScript heap
  after a collection at each sixth of them.
- fuzz: what a page must survive from requests, messages and the contents of its folder.
"""

from __future__ import annotations

import argparse
import csv
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Error, Page, TimeoutError, sync_playwright  # noqa: A004 - playwright's name

from hil.recording.channels import Row
from hil.recording.reader import Recording
from hil.recording.writer import Header, RecordingWriter

ROOT = Path(__file__).parent.parent
HIL = [sys.executable, "-c", "from hil.cli import main; main()"]
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
[dynamixel]
port = "{port}"
model = "xl330-m288"
reply_timeout = 0.3
watchdog = 1.0
"""
SOON = 120_000  # ms


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = {one.__name__: one for one in (paint, stops, cost, hour, fuzz, pictures)}
    parser.add_argument("--only", choices=parts, help="one part of the table")
    parser.add_argument("--stops", type=int, default=100)
    parser.add_argument("--loops", type=int, default=2, help="busy loops beside the stops, 0 where others are busy")
    parser.add_argument("--turns", type=int, default=3, help="runs with the page, and as many without")
    parser.add_argument("--seconds", type=float, default=20.0, help="of such a run")
    parser.add_argument("--rows", type=int, default=3_600_000)
    parser.add_argument("--output", type=Path, default=ROOT / "benchmarks" / "results" / "studio.csv")
    options = parser.parse_args()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for part in [options.only] if options.only else parts:
            rows = []
            with tempfile.TemporaryDirectory() as folder:
                for row in parts[part](Path(folder), browser, options):
                    print(f"{row[0]:62} {row[1]:>28}   bar {row[2]}", flush=True)
                    rows.append(row)
            if part != "pictures":
                written(options.output, part, rows)
        browser.close()


def written(output: Path, part: str, rows: list[tuple[str, str, str]]) -> None:
    """Put the rows of a part in the place of its former ones."""
    with output.open(encoding="utf-8", newline="") as file:
        head, names, *others = csv.reader(file)
    load = f"{time.strftime('%Y-%m-%d')}; load {os.getloadavg()[0]:.0f} on {os.cpu_count()} cores"
    with output.open("w", encoding="utf-8", newline="") as file:
        file.write(f"{','.join(head)}\n")
        csv.writer(file).writerows([names, *(one for one in others if one[0] != part)])
        csv.writer(file).writerows((part, *row, load) for row in rows)


@contextmanager
def studio(folder: Path) -> Iterator[tuple[str, int]]:
    """`hil studio`: its link and its process id."""
    words = [*HIL, "studio", "--port", "0"]
    with subprocess.Popen(words, cwd=folder, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield re.findall(r"http://\S+", process.stderr.readline())[0], process.pid
        finally:
            process.terminate()


def opened(browser: Browser, link: str, script: str = "") -> Page:
    page = browser.new_context(viewport={"width": 1200, "height": 900}).new_page()
    page.add_init_script(script)
    page.set_default_timeout(SOON)
    page.goto(link)
    page.wait_for_selector("#stands input", state="attached")
    return page


def paint(folder: Path, browser: Browser, _options: Any) -> Iterator[tuple[str, str, str]]:
    """First paint, and the page with its stands, s."""
    firsts, wholes = [], []
    for _ in range(5):
        with studio(folder) as (link, _):
            page = opened(browser, link)
            wholes.append(page.evaluate("performance.now()") / 1e3)
            firsts.append(page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime") / 1e3)
            page.context.close()
    yield "first paint, median of 5", f"{np.median(firsts):.2f} s", "1 s"
    yield "the page with its stands, median of 5", f"{np.median(wholes):.2f} s", ""


def pictures(folder: Path, browser: Browser, _options: Any) -> Iterator[tuple[str, str, str]]:
    """Draw a run, a result and an unanswered STOP; a palette of 128 colours makes the files small."""

    def drawn(name: str, page: Page) -> tuple[str, str, str]:
        data = io.BytesIO(page.screenshot())
        file = ROOT / "docs" / "pictures" / f"studio_{name}.png"
        Image.open(data).quantize(128, dither=Image.Dither.NONE).save(file, optimize=True)
        return f"picture {name}", f"{file.stat().st_size / 1e3:.0f} kB", "120 kB"

    with studio(folder) as (link, server):
        page = opened(browser, link)
        page.click("#to-record")
        page.get_by_text("Commands and rate").click()
        page.fill("[name=rate]", "200")  # a busy computer keeps up with it
        page.get_by_text("Commands and rate").click()
        page.locator("#predicted", has_text="predicted standard errors").wait_for()
        page.click("#start")
        page.locator("#left", has_text=re.compile(r"^(\d|1[0-3])\.")).wait_for()
        yield drawn("record", page)
        page.click("#to-identify")
        page.locator("#trace-plot canvas").wait_for()
        page.locator("#report iframe").wait_for()
        page.evaluate("scrollTo(0, 0)")
        yield drawn("identify", page)
        page.click("[data-step=record]")
        page.click("#start")
        page.locator("#left", has_text=re.compile("^1[0-5]")).wait_for()
        os.kill(server, signal.SIGSTOP)
        page.click("#stop")
        page.locator("[data-tone=bad]").wait_for()
        page.set_viewport_size({"width": 1200, "height": 420})
        yield drawn("red", page)
        os.kill(server, signal.SIGCONT)
        page.locator("body[data-moving=no]").wait_for()
        page.context.close()


def processor_time(process: int) -> float:
    """Processor time of a process so far, s."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return sum(int(fields[at]) for at in (11, 12)) / os.sysconf("SC_CLK_TCK")


def browser_processes() -> list[int]:
    """The processes of the browser that this script started."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    ours, grown = {os.getpid()}, True
    while grown:
        new = {one for one, parent in parents.items() if parent in ours} - ours
        ours, grown = ours | new, bool(new)
    names = {one: Path(f"/proc/{one}/comm") for one in ours}
    return [one for one, name in names.items() if name.exists() and "chrom" in name.read_text()]


def cost(folder: Path, browser: Browser, options: Any) -> Iterator[tuple[str, str, str]]:
    """Ticks missed at 500 Hz without the page and with it, and the processor time of the page."""
    missed: dict[str, list[tuple[int, int]]] = {"bare": [], "page": []}
    shares: list[tuple[float, float]] = []
    received, frames = [], [0]

    def count(data: Any) -> None:
        frames[0] += isinstance(data, bytes)

    bare = [*HIL, "record", "--backend", "sim", "--realtime", "--json", f"--duration={options.seconds}"]
    with studio(folder) as (link, server):
        page = opened(browser, link)
        page.on("websocket", lambda one: one.on("framereceived", count))
        for _ in range(options.turns):
            page.goto("about:blank")
            subprocess.run(bare, cwd=folder, capture_output=True, check=False)  # a busy computer may end it early
            missed["bare"].append(missed_ticks(folder))
            page.goto(link.partition("#")[0])
            page.wait_for_selector("#stands input", state="attached")
            page.click("#to-record")
            page.fill("[name=duration]", str(options.seconds))
            page.click("#start")
            page.locator("#figures", has_text=re.compile(r"Kc so far[\d.]")).wait_for()
            processes, began = browser_processes(), time.monotonic()
            before = processor_time(server), sum(map(processor_time, processes))
            frames[0] = 0
            page.wait_for_timeout(600.0 * options.seconds)
            received.append(frames[0] / (time.monotonic() - began))
            after = processor_time(server), sum(map(processor_time, processes))
            shares.append(tuple((b - a) / (time.monotonic() - began) for a, b in zip(before, after, strict=True)))
            page.wait_for_selector("#to-identify", state="visible")
            missed["page"].append(missed_ticks(folder))
        page.context.close()
    for name, words in (("bare", "hil record alone"), ("page", "hil record with the page")):
        lost, ticks = (sum(column) for column in zip(*missed[name], strict=True))
        yield f"ticks missed at 500 Hz, {words}", f"{lost} of {ticks} ({lost / ticks:.2%})", "as many as alone"
    server_share, browser_share = np.median(shares, axis=0)
    yield "the server during a run", f"{server_share:.1%} of a core", "10 %"
    yield "frames of traces received, a second, least of the turns", f"{min(received):.0f}", "30"
    yield "the browser during a run, without a graphics card", f"{browser_share:.0%} of a core", ""


def missed_ticks(folder: Path) -> tuple[int, int]:
    """The missed ticks of the newest recording, and all of them."""
    newest = max((folder / "recordings").glob("*.h5"), key=lambda one: one.stat().st_mtime)
    with Recording(newest) as recording:
        return int(recording.attributes["missed"]), len(recording)


def hour(folder: Path, browser: Browser, options: Any) -> Iterator[tuple[str, str, str]]:
    """The JavaScript heap while an hour of rows arrives."""
    (folder / "recordings").mkdir()
    writer = RecordingWriter(
        folder / "recordings" / "hour.h5",
        Header(profile={"kind": "chirp", "mode": "torque", "duration": options.rows / 1000.0, "rate": 1000.0}),
        options.rows,
        batch=2000,
    )
    heaps, residents = [], []
    with writer, studio(folder) as (link, _):
        writer.append(Row(0, 0.0, 0.0, 0.0, 0.0, 0.0))
        page = opened(browser, link)
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable")
        began = time.monotonic()
        for seq in range(1, options.rows):
            t = seq / 1000.0
            writer.append(Row(seq, t, np.sin(t), np.sin(3.0 * t), np.cos(3.0 * t), 0.0))
            if (6 * (seq + 1)) // options.rows != (6 * seq) // options.rows:
                session.send("HeapProfiler.collectGarbage")
                table = session.send("Performance.getMetrics")["metrics"]
                heaps.append(next(one["value"] for one in table if one["name"] == "JSHeapUsedSize") / 1e6)
                residents.append(sum(map(resident, browser_processes())))
        took = time.monotonic() - began
        page.context.close()
    label = f"{options.rows} rows of 1 kHz in {took:.0f} s, at each sixth"
    yield f"{label}: JavaScript heap", " ".join(f"{one:.1f}" for one in heaps) + " MB", "constant"
    yield f"{label}: browser", " ".join(f"{one:.0f}" for one in residents) + " MB", "constant"


def fuzz(_folder: Path, _browser: Browser, _options: Any) -> Iterator[tuple[str, str, str]]:
    """Requests, messages and folders that nobody meant: the long form of a test."""
    words = ["-q", "-n", "0", "-m", "study", "tests/hil/studio/test_fuzz.py"]
    began = time.monotonic()
    done = subprocess.run([sys.executable, "-m", "pytest", *words], cwd=ROOT, check=False).returncode
    found = f"{'none' if done == 0 else 'A FAULT'} in {time.monotonic() - began:.0f} s, below 300 MB"
    yield "5000 odd requests, messages and folder contents: faults", found, "none, 300 MB"


def resident(process: int) -> float:
    """The memory of a process that it shares with no other, MB."""
    fields = Path(f"/proc/{process}/statm").read_text().split()
    return (int(fields[1]) - int(fields[2])) * os.sysconf("SC_PAGE_SIZE") / 1e6


def stops(folder: Path, browser: Browser, options: Any) -> Iterator[tuple[str, str, str]]:
    """From the press to the torque off, and to an answer or the alarm, ms."""
    log = folder / "torque.csv"
    (folder / "finger.toml").write_text(STAND.format(port=folder / "ttyDXL"))
    words = ["emulate", "dynamixel", "--link", str(folder / "ttyDXL"), "--stand", "finger.toml", "--log", str(log)]
    wanted = {"kind": "record", "stand": "finger.toml", "rate": "200", "duration": "30", "yes": True}
    took, answered, loads, tried = [], [], [], 0
    with ExitStack() as stack:
        for _ in range(options.loops):
            stack.callback(stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"])).kill)
        drive = stack.enter_context(subprocess.Popen([*HIL, *words], cwd=folder, stderr=subprocess.PIPE, text=True))
        stack.callback(drive.send_signal, signal.SIGINT)
        drive.stderr.readline()
        link, _ = stack.enter_context(studio(folder))
        page = opened(browser, link, PRESSES)
        page.locator("body[data-moving=no]").wait_for(state="attached")
        while len(took) < options.stops:
            tried += 1
            if page.is_visible("#read"):  # the alarm of a run that broke off would hide every later answer
                page.click("#read")
            with suppress(TimeoutError, Error):  # a busy computer was late and the run ended by itself
                page.evaluate("one => { window.press = {}; return Link.ask('/api/start', one); }", wanted)
                page.locator("#left", has_text=re.compile("^[12]")).wait_for(timeout=30_000)
                press(page, len(took))
            pressed = answer(page)
            page.locator("body[data-moving=no]").wait_for(state="attached")
            since = pressed.get("at", 1e3 * time.time()) / 1e3 - time.time() + time.monotonic()
            ms = 1e3 * (switched_off(log, since) - since)
            if np.isnan(ms):  # it had ended by itself before
                continue
            took.append(ms)
            answered.append(pressed.get("answered", np.inf) - pressed["at"])
            loads.append(os.getloadavg()[0] / os.cpu_count())
        page.context.close()
    label = f"{len(took)} stops of {tried} runs, {options.loops} busy loops, load {np.median(loads):.1f} a core"
    numbers = "{:.0f}, {:.0f}, {:.0f} ms"
    found = numbers.format(*np.quantile(took, [0.5, 0.99, 1.0]))
    yield f"press to torque off on an emulated drive, {label}: median, 99 %, largest", found, "150 ms in 99 %"
    yield "the same: within 150 ms", f"{sum(one <= 150.0 for one in took)} of {len(took)}", "99 %"
    found = numbers.format(
        *np.quantile(answered, [0.5, 0.99, 1.0], method="higher")
    )  # one may have no answer: infinite
    yield "press to an answer or the alarm in the band: median, 99 %, largest", found, "1.5 s in all"


PRESSES = """
for (const kind of ["keydown", "pointerdown"]) addEventListener(kind, (event) => {
  if (document.body.dataset.moving === "yes") press.at = press.at || performance.timeOrigin + event.timeStamp;
}, true);
addEventListener("DOMContentLoaded", () => new MutationObserver(() => {
  const waits = document.getElementById("state").textContent === "STOP sent";
  if (press.at && !waits) press.answered = press.answered || performance.timeOrigin + performance.now();
}).observe(document.getElementById("state"), { childList: true, characterData: true, subtree: true }));
"""


def answer(page: Page) -> dict[str, float]:
    """Return the times of a press and of its answer, without this after 10 s. The page's policy lets no text of
    `wait_for_function` run.
    """
    end = time.monotonic() + 10.0
    while "answered" not in (found := page.evaluate("press")) and time.monotonic() < end:
        time.sleep(0.02)
    return dict(found)


def press(page: Page, number: int) -> None:
    """Press STOP or a key, by turns; `number` chooses the key and what has the focus."""
    if number % 2:
        places = ["[data-step=identify]", "#record .line summary", "#stop", "body"]
        place, key = places[number // 2 % 4], ["x", "Enter", "Escape", "Tab", " ", "ArrowDown", "F5"][number // 2 % 7]
        page.evaluate("place => { document.activeElement.blur(); document.querySelector(place).focus(); }", place)
        page.keyboard.press(key)
    else:
        page.click("#stop")


def switched_off(log: Path, after: float) -> float:
    """The time of the first row after `after` in which the drive has its torque off, s; NaN without one."""
    with log.open(encoding="ascii") as file:
        rows = [row for row in csv.DictReader(file) if float(row["time_s"]) > after and row["enabled"] == "0"]
    return float(rows[0]["time_s"]) if rows else float("nan")


if __name__ == "__main__":
    main()
