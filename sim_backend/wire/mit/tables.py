"""Motors that speak MIT frames, and the registers of a Damiao.

Sources: CubeMars AK Series Driver Manual 1.0.8, section 5.3; the parameter tables of open drivers for AK and Damiao
motors; Damiao's register list as published with its debugging tool. Torque constant and resistance at the output are
round numbers of the right size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MitModel:
    """A motor. span: position rad, velocity rad/s, torque N m that fill the counts; gear: reduction ratio.

    scale: the paper's joint with torques as large as suit it. torque_constant N m/A and resistance Ohm, at the output.
    """

    damiao: bool
    span: tuple[float, float, float]
    gear: float
    scale: float
    torque_constant: float
    resistance: float


MODELS = {
    "ak10-9": MitModel(False, (12.5, 50.0, 65.0), 9.0, 600.0, 1.4, 0.1),
    "ak60-6": MitModel(False, (12.5, 50.0, 15.0), 6.0, 150.0, 0.4, 0.2),
    "ak70-10": MitModel(False, (12.5, 50.0, 25.0), 10.0, 250.0, 0.9, 0.3),
    "ak80-6": MitModel(False, (12.5, 76.0, 12.0), 6.0, 120.0, 0.5, 0.2),
    "ak80-9": MitModel(False, (12.5, 50.0, 18.0), 9.0, 180.0, 0.8, 0.2),
    "ak80-64": MitModel(False, (12.5, 8.0, 144.0), 80.0, 1400.0, 8.0, 0.4),
    "dm-j3507": MitModel(True, (12.566, 50.0, 5.0), 7.0, 50.0, 0.5, 0.9),
    "dm-j4310": MitModel(True, (12.5, 30.0, 10.0), 10.0, 100.0, 0.945, 0.85),
    "dm-j4310-48v": MitModel(True, (12.5, 50.0, 10.0), 10.0, 100.0, 0.945, 0.85),
    "dm-j4340": MitModel(True, (12.5, 10.0, 28.0), 40.0, 280.0, 3.78, 0.85),
    "dm-j6006": MitModel(True, (12.5, 45.0, 20.0), 6.0, 200.0, 0.9, 0.3),
    "dm-j8006": MitModel(True, (12.5, 45.0, 40.0), 6.0, 400.0, 1.2, 0.2),
    "dm-j8009": MitModel(True, (12.5, 45.0, 54.0), 9.0, 540.0, 1.8, 0.2),
    "dm-h3510": MitModel(True, (12.5, 280.0, 1.0), 1.0, 10.0, 0.06, 0.5),
}
"""By the name used in stand files."""


@dataclass(frozen=True, slots=True)
class Item:
    """A register of a Damiao. whole: an unsigned integer, otherwise a float. low, high: what a write must keep to."""

    name: str
    initial: float
    whole: bool = False
    writable: bool = False
    low: float = -math.inf
    high: float = math.inf


def registers(model: MitModel, ident: int, reply_id: int) -> dict[int, Item]:
    """The registers of a Damiao by their numbers."""
    position, velocity, torque = model.span
    rows = {
        0: Item("UV_Value", 15.0, writable=True, low=10.0),
        1: Item("KT_Value", model.torque_constant, writable=True, low=0.0),
        2: Item("OT_Value", 120.0, writable=True, low=80.0, high=199.9),
        3: Item("OC_Value", 0.98, writable=True, low=0.0, high=1.0),
        4: Item("ACC", 2.0, writable=True, low=0.0),
        5: Item("DEC", -2.0, writable=True, high=0.0),
        6: Item("MAX_SPD", velocity, writable=True, low=0.0),
        7: Item("MST_ID", reply_id, whole=True, writable=True, low=0, high=0x7FF),
        8: Item("ESC_ID", ident, whole=True, writable=True, low=0, high=0x7FF),
        9: Item("TIMEOUT", 0, whole=True, writable=True, low=0, high=2**32 - 1),
        10: Item("CTRL_MODE", 1, whole=True, writable=True, low=1, high=4),
        11: Item("Damp", 1e-5),
        12: Item("Inertia", 1.8e-5),
        13: Item("hw_ver", 1, whole=True),
        14: Item("sw_ver", 5015, whole=True),
        15: Item("SN", 1234567, whole=True),
        16: Item("NPP", 14, whole=True),
        17: Item("Rs", model.resistance),
        18: Item("Ls", 345e-6),
        19: Item("Flux", 0.0045),
        20: Item("Gr", model.gear),
        21: Item("PMAX", position, writable=True, low=0.0),
        22: Item("VMAX", velocity, writable=True, low=0.0),
        23: Item("TMAX", torque, writable=True, low=0.0),
        24: Item("I_BW", 1000.0, writable=True, low=100.0, high=10_000.0),
        25: Item("KP_ASR", 3.72e-4, writable=True, low=0.0),
        26: Item("KI_ASR", 2e-3, writable=True, low=0.0),
        27: Item("KP_APR", 50.0, writable=True, low=0.0),
        28: Item("KI_APR", 0.0, writable=True, low=0.0),
        29: Item("OV_Value", 32.0, writable=True),
        30: Item("GREF", 0.95, writable=True, low=0.0, high=1.0),
        31: Item("Deta", 4.0, writable=True, low=1.0, high=30.0),
        32: Item("V_BW", 50.0, writable=True, low=0.0, high=500.0),
        33: Item("IQ_c1", 500.0, writable=True, low=100.0, high=10_000.0),
        34: Item("VL_c1", 500.0, writable=True, low=0.0, high=10_000.0),
        35: Item("can_br", 4, whole=True, writable=True, low=0, high=4),
        36: Item("sub_ver", 1, whole=True),
        59: Item("Imax", 10.261),
        60: Item("VBus", 24.0),
        61: Item("Tpcb", 25.0),
        62: Item("Tmtr", 25.0),
        80: Item("p_m", 0.0),
        81: Item("xout", 0.0),
    }
    return rows | {number: Item(f"calibration_{number}", 0.0) for number in (50, 51, 52, 53, 54, 55, 56, 63, 64, 65)}
