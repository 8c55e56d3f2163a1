"""The joint of an emulated drive whose plant is not given: as stiff as the drive's torque needs."""

from __future__ import annotations

from sim_backend.parameters import (
    CouplingParameters,
    DriveParameters,
    FixtureParameters,
    LinkParameters,
    MotorParameters,
    SimParameters,
)

TURNED, SHARE = 0.5, 0.2
"""rad by which the joint turns under this share of the drive's torque limit."""


def fitting_joint(
    torque_limit: float, torque_constant: float, resistance: float, *, inertia: float = 0.0
) -> SimParameters:
    """Return the default joint of a drive with `torque_limit`, N m: the paper's joint, scaled so that it turns by
    `TURNED` under `SHARE` of the limit. The other arguments are those of `scaled_joint`.
    """
    scale = SHARE * torque_limit / (TURNED * CouplingParameters().stiffness)
    return scaled_joint(scale, torque_constant, resistance, inertia=inertia)


def scaled_joint(
    scale: float, torque_constant: float, resistance: float, *, friction: bool = True, inertia: float = 0.0
) -> SimParameters:
    """Return the paper's joint with every torque multiplied by `scale`, driven without a gear.

    Stiffness, damping, inertias and friction are all scaled, so the motion is that of the paper's joint and the same
    chirp suits it. torque_constant: N m/A. resistance: Ohm, of the motor's winding. friction: whether the cable has dry
    friction. inertia: kg m^2 of the motor at its output; 0: the paper's, scaled.
    """
    paper, fixture = CouplingParameters(), FixtureParameters()
    return SimParameters(
        motor=MotorParameters(
            gear_ratio=1.0,
            inertia=inertia or 3.2e-6 * scale,
            viscous_friction=1.6e-6 * scale,
            torque_constant=torque_constant,
            winding_resistance=resistance,
            winding_heat_capacity=60.0,
            winding_thermal_resistance=1.0,
            housing_heat_capacity=200.0,
            housing_thermal_resistance=3.0,
        ),
        coupling=CouplingParameters(
            stiffness=paper.stiffness * scale,
            damping=paper.damping * scale,
            coulomb_friction=paper.coulomb_friction * scale if friction else 0.0,
            bristle_stiffness=paper.bristle_stiffness * scale,
            bristle_damping=paper.bristle_damping * scale,
        ),
        fixture=FixtureParameters(
            stiffness=fixture.stiffness * scale, damping=fixture.damping * scale, inertia=fixture.inertia * scale
        ),
        drive=DriveParameters(torque_limit=scale),
        link=LinkParameters(lost_reply=0.0, jitter=0.0),
    )
