"""Count the ticks that the recorder makes in a second of processor time, where time is virtual.

python benchmarks/tick_rate.py

Through a bare double, whose reading is a few divisions, and through the simulated servo; into memory and into a file.
Prints the best of `--turns` runs of each, since other work on this computer makes the processor slower.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import cast

from drivers.clock import VirtualClock
from drivers.servo import Command, Limits, Quantity, Sample, Servo, ServoInfo
from hil.acquisition import excitation
from hil.acquisition.interrupt import StopRequest
from hil.acquisition.recorder import Recorder, tick_count
from hil.acquisition.sink import Memory
from hil.recording.writer import Header, RecordingWriter
from hil.stand.file import SIMULATED, Stand, parse
from hil.stand.opening import open_servo

RATE = 1000.0  # Hz


class Bare:
    """A massless motor of gear ratio 4 on a spring."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.info = ServoInfo("double", "bare", watchdog=0.1)

    def arm(self, limits: Limits) -> None:
        """Take any limits."""

    def exchange(self, command: Command) -> Sample:
        """Answer at once."""
        t, value = self.clock.now(), command.value
        return Sample(t, t + 1e-4, 2.0 * value, 0.0, value, 0.0, 4.0 * value, 30.0, 12.0)

    def disarm(self) -> None:
        """Nothing is on."""

    def close(self) -> None:
        """Nothing is open."""


def opened(stand: Stand, *, bare: bool) -> Servo:
    """Return a servo in virtual time."""
    return cast("Servo", Bare()) if bare else open_servo(stand)[0]


def ticks(seconds: float, *, bare: bool, file: bool) -> float:
    """Return the ticks a second of processor time in a run of `seconds` s."""
    stand = parse(SIMULATED)
    half = 0.5 * stand.checked_limits().torque
    profile = excitation.make(
        "sine", Quantity.TORQUE, amplitude=half, default_amplitude=half, duration=seconds, band=(2.0, 2.0), rate=RATE
    )
    with tempfile.TemporaryDirectory() as folder:
        header = Header(profile=profile.attributes() | {"rate": RATE})
        writer = RecordingWriter(Path(folder) / "a.h5", header, tick_count(profile, RATE), batch=20) if file else None
        recorder = Recorder(stand, opened(stand, bare=bare), profile, RATE, writer or Memory(), scratch=Path(folder))
        begin = time.process_time()
        outcome = recorder.run(StopRequest())
        used = time.process_time() - begin
        if writer is not None:
            writer.close()
    if outcome.error is not None:
        raise outcome.error
    return outcome.samples / used


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="of a run, at 1 kHz")
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f}\n\n| servo | rows go to | ticks a processor second |\n| --- | --- | --- |")
    for bare in (True, False):
        for file in (False, True):
            best = max(ticks(options.seconds, bare=bare, file=file) for _ in range(options.turns))
            name = "bare double" if bare else "simulated servo"
            print(f"| {name} | {'a file' if file else 'memory'} | {best:.0f} |", flush=True)


if __name__ == "__main__":
    main()
