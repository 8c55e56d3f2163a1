"""The simulated servo: a drive with the plant, behind a link that takes time and loses replies."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from drivers.clock import Clock
from drivers.gate import Gate
from drivers.servo import (
    Command,
    DeviceFault,
    DriverError,
    Limits,
    NoReply,
    Quantity,
    Sample,
    ServoInfo,
    Status,
)
from sim_backend.drive import REMEDY, Drive, FaultCode
from sim_backend.integrator import STATE
from sim_backend.neighbours import Neighbours
from sim_backend.plant import (
    CELL,
    JOINT,
    JOINT_RATE,
    MOTOR,
    MOTOR_RATE,
    TORQUE,
    WINDING,
)
from sim_backend.sensors import Noise, Sensors

if TYPE_CHECKING:
    from sim_backend.parameters import SimParameters


_GOOD = Status(0)


@dataclass(frozen=True, slots=True)
class TrueState:
    """The exact state of the simulated stand, which no sensor measures.

    t: s on the servo's clock. motor_position rad, motor_velocity rad/s, motor_torque N m: at the motor shaft.
    torque_demand: torque that is demanded of the current loop, N m. joint_position rad, joint_velocity rad/s: at the
    joint. coupling_torque: sigma_c, N m. cell_torque: N m at the torque cell before sampling. winding_temperature:
    degC. enabled: whether current can flow.
    """

    t: float
    motor_position: float
    motor_velocity: float
    motor_torque: float
    torque_demand: float
    joint_position: float
    joint_velocity: float
    coupling_torque: float
    cell_torque: float
    winding_temperature: float
    enabled: bool


class SimServo:
    """A simulated servo. The same parameters, seed and commands give the same samples bit for bit.

    watched: whether the drive's watchdog works; `info` states it in any case. neighbours: as the `turns` of
    `Neighbours`. Raises ValueError if the seed is negative.
    """

    def __init__(
        self,
        parameters: SimParameters,
        *,
        seed: int,
        clock: Clock,
        watched: bool = True,
        neighbours: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self._parameters = parameters.resolved()
        self._link, self._delay = self._parameters.link, self._parameters.drive.command_delay
        self._one_way = 0.5 * self._link.round_trip
        self.clock: Clock = clock
        self._opened = clock.now()
        self._drive = Drive(self._parameters, watchdog=self._link.watchdog if watched else math.inf)
        self._sensors = Sensors(self._parameters)
        self._neighbours = Neighbours(self._drive, neighbours, self._sensors.position_lsb)
        self._watches = bool(neighbours)
        self._draws = Noise(seed).draws
        self._under_way: deque[tuple[float, Command]] = deque()
        self.info = ServoInfo(
            backend="sim",
            model="simulated joint",
            serial=f"seed {seed}",
            position_lsb=self._sensors.position_lsb,
            velocity_lsb=self._parameters.sensors.velocity_lsb,
            torque_lsb=self._sensors.torque_lsb,
            torque_uncertainty=0.0,
            watchdog=self._parameters.link.watchdog,
        )
        self._gate = Gate(
            "the simulated servo",
            self.info.quantities,
            torque_off=self._torque_off,
            release=lambda: None,
            clock=self.clock,
        )
        self._gate.live = False

    def arm(self, limits: Limits) -> None:
        """Write the limits into the drive and enable it at zero torque.

        The lower of the drive's own torque limit and `limits.torque` acts. The position range limits set-points only.
        Raises LinkLost if the servo is closed, DeviceFault if a fault is latched, DriverError if the torque limit is
        below one count.
        """
        self._gate.require_open()
        self._advance(self.clock.now())
        self._raise_fault()
        if limits.torque < self._sensors.torque_lsb:
            raise DriverError(
                f"torque limit {limits.torque:.3g} N m is below one count of the drive, "
                f"{self._sensors.torque_lsb:.3g} N m: raise it"
            )
        with self._gate.arming(limits):
            self._under_way.clear()
            self._neighbours.begin()
            self._drive.enable(limits)

    def exchange(self, command: Command) -> Sample:
        """Send the set-point and read the state. The clock advances by a round trip, or by the timeout if the reply is
        lost.

        The set-point acts only after its arrival, so the sample holds the state before the set-point. After a fault is
        latched, every call raises it. Raises NoReply, LinkLost, DeviceFault, and DriverError if a neighbour turns.
        """
        admitted = self._gate.admit(command)
        out, back, lost, motor_noise, cell_noise = next(self._draws)
        sent, opened = self.clock.now(), self._opened
        link = self._link
        outbound, inbound = self._one_way + link.jitter * out, self._one_way + link.jitter * back
        arrived = sent + (outbound if outbound > 0.0 else 0.0)
        returned = arrived + (inbound if inbound > 0.0 else 0.0)
        self._take_over(arrived - opened)
        reading = self._sensors.read(self._drive, arrived - opened, motor_noise, cell_noise)
        self._drive.feed()
        self._under_way.append((arrived + self._delay - opened, admitted.command or Command.rest()))
        if lost < link.lost_reply or returned - sent > link.reply_timeout:
            self.clock.sleep_until(sent + link.reply_timeout)
            raise NoReply(f"no reply within {link.reply_timeout * 1e3:.3g} ms")
        self.clock.sleep_until(returned)
        if self._drive.fault:
            self._raise_fault()
        if self._watches and self._gate.armed:
            self._neighbours.look()
        saturated = self._drive.take_saturated() or (command.quantity is Quantity.TORQUE and admitted.clipped)
        return Sample(sent, 0.5 * (sent + returned), *reading, Status.SATURATED if saturated else _GOOD)

    def disarm(self) -> None:
        """Switch the torque off. Raises DriverError if the drive does not confirm it; then its watchdog switches the
        torque off.
        """
        self._gate.disarm()

    def close(self) -> None:
        """Switch the torque off, then close the link. Never raises."""
        self._gate.close()

    def slower(self) -> tuple[float, float]:
        """See `drivers.neighbours.SeesNeighbours`: looking at simulated neighbours takes no time."""
        return 0.0, 0.0

    def turned(self) -> Mapping[str, float]:
        """See `drivers.neighbours.SeesNeighbours`."""
        return self._neighbours.turned()

    def truth(self) -> dict[str, float]:
        """Return the true parameters, which the recording stores in `/truth`: SI units, at the joint unless the name
        says motor.

        skew_motor, skew_joint: age of the torque reading minus age of the angle reading, s, including the delay of
        filters.
        """
        p = self._parameters
        c, sensors = self._drive.constants, p.sensors
        return {
            "Kc": c.stiffness,
            "Bc": c.damping,
            "K3": c.cubic,
            "Fc": c.coulomb,
            "gap": c.gap,
            "slack": c.slack,
            "hysteresis_torque": c.hysteresis_torque,
            "gear_ratio": c.gear_ratio,
            "motor_inertia": c.inertia,
            "motor_damping": c.viscous_friction,
            "fixture_stiffness": c.fixture_stiffness,
            "joint_inertia": c.joint_inertia,
            "tau0": sensors.torque_cell_offset,
            "drift": sensors.torque_cell_drift,
            "skew_motor": sensors.motor_torque_delay - sensors.motor_position_delay,
            "skew_joint": sensors.joint_torque_delay + 1.0 / c.cell_rate - sensors.motor_position_delay,
        }

    def true_state(self) -> TrueState:
        """Return the plant's state at the present time of the clock, for tests. The servo may be open or closed; no
        time passes.
        """
        self._advance(self.clock.now())
        drive = self._drive
        state = drive.path[STATE]
        return TrueState(
            t=self._opened + drive.time,
            motor_position=float(state[MOTOR]),
            motor_velocity=float(state[MOTOR_RATE]),
            motor_torque=float(state[TORQUE]),
            torque_demand=drive.demand,
            joint_position=float(state[JOINT]),
            joint_velocity=float(state[JOINT_RATE]),
            coupling_torque=drive.coupling_torque,
            cell_torque=float(state[CELL]),
            winding_temperature=float(state[WINDING]),
            enabled=drive.enabled,
        )

    def _torque_off(self, _request: int) -> None:
        self._advance(self.clock.now())
        self._under_way.clear()
        self._drive.disable()

    def _raise_fault(self) -> None:
        code = self._drive.fault
        if code == 0:
            return
        raise DeviceFault(code, f"the drive latched fault {code}: {REMEDY[FaultCode(code)]}")

    def _advance(self, t: float) -> None:
        """Simulate the drive up to the time `t` on the clock, with set-points at their times."""
        until = t - self._opened
        self._take_over(until)
        self._drive.run(until)

    def _take_over(self, until: float) -> None:
        """Apply the set-points that arrive up to `until`, s since the servo was opened."""
        while self._under_way and self._under_way[0][0] <= until:
            due, command = self._under_way.popleft()
            self._drive.follow(command, due)
