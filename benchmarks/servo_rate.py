"""How many ticks a second a servo gives, against what its bus permits, and what a tick costs the processor.

Run from the root of the repository: `python benchmarks/servo_rate.py [dynamixel] [feetech]`. The emulated servo answers
from a process of its own over a pty, with the times of baud rate, packets, return delay and a USB adapter that holds
bytes for 1 ms.
"""

from __future__ import annotations

import multiprocessing
import platform
import statistics
import sys
import tempfile
import time
from multiprocessing.synchronize import Event
from pathlib import Path

from drivers.dynamixel.config import DynamixelConfig
from drivers.dynamixel.servo import DynamixelServo
from drivers.feetech.config import FeetechConfig
from drivers.feetech.servo import FeetechServo
from drivers.servo import BadReply, Command, Limits, NoReply, Quantity, Servo

USB_LATENCY = 1e-3
LIMITS = Limits(torque=0.03, velocity=40.0, temperature=65.0, position=(-3.0, 3.0))
TICKS = 500
REPEATS = 15
FAMILIES = {
    "dynamixel": (17 + 14 + 38.0, (1_000_000, 4_000_000)),  # Sync Write, Read, status packet with 27 bytes
    "feetech": (
        11 + 8 + 21 + 2.5,
        (1_000_000,),
    ),  # 15 bytes, and 2.5 on average against late replies
}
"""Bytes on the wire in a tick, and bit/s."""


def serve(family: str, link: str, baudrate: int, ready: Event, done: Event) -> None:
    from sim_backend.wire.dynamixel.device import DynamixelDevice
    from sim_backend.wire.feetech.device import FeetechDevice
    from sim_backend.wire.packets.bus import PacketBus, PacketTiming
    from sim_backend.wire.uart.pty_line import PtyLine

    bus = PacketBus([], timing=PacketTiming(usb_latency=USB_LATENCY), protocol=1 if family == "feetech" else 2)
    with PtyLine(Path(link), bus) as line:
        if family == "feetech":
            bus.devices.append(FeetechDevice("hls3930m", baudrate=baudrate, now=line.now()))
        else:
            bus.devices.append(DynamixelDevice("xl330-m288", baudrate=baudrate, now=line.now()))
        ready.set()
        done.wait()


def opened(family: str, link: str, baudrate: int) -> Servo:
    if family == "feetech":
        return FeetechServo(FeetechConfig(link, "hls3930m", baudrate=baudrate, reply_timeout=0.04))  # type: ignore[arg-type]  # one of the Literal
    return DynamixelServo(DynamixelConfig(link, "xl330-m288", baudrate=baudrate, reply_timeout=0.04))  # type: ignore[arg-type]


def tick(servo: Servo, number: int) -> bool:
    try:
        servo.exchange(Command(Quantity.TORQUE, 0.002 * (number % 5 - 2)))
    except (NoReply, BadReply):
        return False
    return True


def flat_out(servo: Servo) -> tuple[float, float, int]:
    """Ticks a second, s of processor time a tick, and how many replies were lost."""
    begin, used = time.perf_counter(), time.process_time()
    good = sum(tick(servo, number) for number in range(TICKS))
    return good / (time.perf_counter() - begin), (time.process_time() - used) / TICKS, TICKS - good


def paced(servo: Servo, rate: float) -> float:
    """Share of one processor core that `rate` ticks a second take."""
    clock = servo.clock
    begin, used = clock.now(), time.process_time()
    for number in range(TICKS):
        clock.sleep_until(begin + number / rate)
        tick(servo, number)
    return (time.process_time() - used) / (clock.now() - begin)


def measure(family: str, baudrate: int, folder: str) -> None:
    context = multiprocessing.get_context("spawn")
    ready, done = context.Event(), context.Event()
    link = f"{folder}/tty{family}{baudrate}"
    peer = context.Process(target=serve, args=(family, link, baudrate, ready, done))
    peer.start()
    try:
        ready.wait()
        servo = opened(family, link, baudrate)
        servo.arm(LIMITS)
        runs = [flat_out(servo) for _ in range(REPEATS)]
        shares = [paced(servo, 500.0) for _ in range(REPEATS)]
        servo.close()
    finally:
        done.set()
        peer.join()
    report(family, baudrate, runs, shares)


def report(family: str, baudrate: int, runs: list[tuple[float, float, int]], shares: list[float]) -> None:
    round_trip = 10.0 * FAMILIES[family][0] / baudrate + USB_LATENCY
    rates, costs, lost = zip(*runs, strict=True)
    middle, best, cost = statistics.median(rates), max(rates), min(costs)
    print(
        f"{family}, {baudrate / 1e6:g} Mbaud: {middle:.0f} ticks/s, best {best:.0f}, permitted {1.0 / round_trip:.0f}: "
        f"{middle * round_trip:.1%}, best {best * round_trip:.1%}; {sum(lost)} of {REPEATS * TICKS} lost; "
        f"own work {cost * 1e6:.0f} us a tick, which alone allows {round_trip / (round_trip + cost):.1%}; "
        f"CPU at 500 Hz: {statistics.median(shares):.1%} of a core"
    )


if __name__ == "__main__":
    print(f"{platform.machine()}, Python {platform.python_version()}, {platform.system()}")
    with tempfile.TemporaryDirectory() as folder:
        for family in sys.argv[1:] or FAMILIES:
            for baudrate in FAMILIES[family][1]:
                measure(family, baudrate, folder)
