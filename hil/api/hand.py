"""The results of a hand in Python: the motors, and the matrices of stiffness and damping with named joints."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from hil.api.wording import worded
from hil.errors import WrongUse, unknown
from hil.hand.routing import Finger, JointMatrix, Motor, finger, fingers, read


@dataclass(frozen=True, slots=True)
class HandResult:
    """The results of `hil hand`: `result["index_mcp"]` is one motor with its Kc and Bc. folder: of the results."""

    folder: Path
    motors: tuple[Motor, ...]

    def __getitem__(self, name: str) -> Motor:
        try:
            return next(motor for motor in self.motors if motor.name == name)
        except StopIteration:
            raise KeyError(f"no motor {name!r}; there are {', '.join(one.name for one in self.motors)}") from None

    @property
    def fingers(self) -> tuple[Finger, ...]:
        """The fingers: motors and joints that tendons connect, each with the covariance of its matrices' entries."""
        return tuple(fingers(self.motors))

    @worded
    def stiffness_matrix(self, joint: str | None = None) -> JointMatrix:
        """Return the stiffness, N m/rad, of all joints, or of the finger with the joint of this name. Raises WrongUse.

        Entry (i, j) is the torque at joint i for a deflection of joint j while all motors are held.
        """
        return self._finger(joint).stiffness

    @worded
    def damping_matrix(self, joint: str | None = None) -> JointMatrix:
        """Return the damping, N m s/rad, as `stiffness_matrix` does the stiffness. Raises WrongUse."""
        return self._finger(joint).damping

    def _finger(self, joint: str | None) -> Finger:
        if joint is None:
            return finger(self.motors)
        for each in self.fingers:
            if joint in each.joints:
                return each
        raise unknown("joint", joint, [name for each in self.fingers for name in each.joints])


@worded
def load_hand(folder: str | os.PathLike[str]) -> HandResult:
    """Return the results in the folder that `hil hand` wrote. Raises WrongUse."""
    path = Path(folder)
    if not path.is_dir():
        raise WrongUse(f"{path} is no folder: name the folder that hil hand wrote, which holds hand.json")
    return HandResult(path, read(path))
