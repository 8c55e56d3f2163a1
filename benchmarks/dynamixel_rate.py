"""How many ticks a second a DYNAMIXEL gives, against what its bus permits, and what a tick costs the processor.

Run from the root of the repository: `python benchmarks/dynamixel_rate.py`. The emulated servo answers from a process of
its own over a pty, with the times of baud rate, packets, return delay and a USB adapter that holds bytes for 1 ms.
"""

from __future__ import annotations

import multiprocessing
import platform
import statistics
import tempfile
import time
from multiprocessing.synchronize import Event
from pathlib import Path

from drivers.dynamixel.config import DynamixelConfig
from drivers.dynamixel.servo import DynamixelServo
from drivers.servo import BadReply, Command, Limits, NoReply, Quantity

USB_LATENCY = 1e-3
BYTES = 17 + 14 + 38  # Sync Write, Read, status packet with 27 bytes
LIMITS = Limits(torque=0.03, velocity=40.0, temperature=65.0, position=(-3.0, 3.0))
TICKS = 500
REPEATS = 15


def serve(link: str, baudrate: int, ready: Event, done: Event) -> None:
    from sim_backend.wire.dynamixel.device import DynamixelDevice
    from sim_backend.wire.packets.bus import PacketBus, PacketTiming
    from sim_backend.wire.uart.pty_line import PtyLine

    bus = PacketBus([], timing=PacketTiming(usb_latency=USB_LATENCY))
    with PtyLine(Path(link), bus) as line:
        bus.devices.append(DynamixelDevice("xl330-m288", baudrate=baudrate, now=line.now()))
        ready.set()
        done.wait()


def tick(servo: DynamixelServo, number: int) -> bool:
    try:
        servo.exchange(Command(Quantity.TORQUE, 0.002 * (number % 5 - 2)))
    except (NoReply, BadReply):
        return False
    return True


def flat_out(servo: DynamixelServo) -> tuple[float, float, int]:
    """Ticks a second, s of processor time a tick, and how many replies were lost."""
    begin, used = time.perf_counter(), time.process_time()
    good = sum(tick(servo, number) for number in range(TICKS))
    return good / (time.perf_counter() - begin), (time.process_time() - used) / TICKS, TICKS - good


def paced(servo: DynamixelServo, rate: float) -> float:
    """Share of one processor core that `rate` ticks a second take."""
    clock = servo.clock
    begin, used = clock.now(), time.process_time()
    for number in range(TICKS):
        clock.sleep_until(begin + number / rate)
        tick(servo, number)
    return (time.process_time() - used) / (clock.now() - begin)


def measure(baudrate: int, folder: str) -> None:
    context = multiprocessing.get_context("spawn")
    ready, done = context.Event(), context.Event()
    link = f"{folder}/tty{baudrate}"
    peer = context.Process(target=serve, args=(link, baudrate, ready, done))
    peer.start()
    try:
        ready.wait()
        servo = DynamixelServo(
            DynamixelConfig(port=link, model="xl330-m288", baudrate=baudrate, reply_timeout=0.04)  # type: ignore[arg-type]  # one of the Literal
        )
        servo.arm(LIMITS)
        runs = [flat_out(servo) for _ in range(REPEATS)]
        shares = [paced(servo, 500.0) for _ in range(REPEATS)]
        servo.close()
    finally:
        done.set()
        peer.join()
    report(baudrate, runs, shares)


def report(baudrate: int, runs: list[tuple[float, float, int]], shares: list[float]) -> None:
    round_trip = 10.0 * BYTES / baudrate + USB_LATENCY
    rates, costs, lost = zip(*runs, strict=True)
    middle, best, cost = statistics.median(rates), max(rates), min(costs)
    print(
        f"{baudrate / 1e6:g} Mbaud: {middle:.0f} ticks/s, best run {best:.0f}, of {1.0 / round_trip:.0f} permitted: "
        f"{middle * round_trip:.1%}, best {best * round_trip:.1%}; {sum(lost)} of {REPEATS * TICKS} lost; "
        f"own work {cost * 1e6:.0f} us a tick, which alone allows {round_trip / (round_trip + cost):.1%}; "
        f"CPU at 500 Hz: {statistics.median(shares):.1%} of a core"
    )


if __name__ == "__main__":
    print(f"{platform.machine()}, Python {platform.python_version()}, {platform.system()}")
    with tempfile.TemporaryDirectory() as folder:
        for baudrate in (1_000_000, 4_000_000):
            measure(baudrate, folder)
