"""The states that a client may request of an emulated ODrive axis, and the durations of the procedures among these
states.

Source: the 0.5.6 firmware's axis.cpp (run_state_machine_loop), motor.cpp (run_calibration: 3 s and 1.25 s) and
encoder.cpp (run_offset_calibration: 1 s, then 16 pi rad at 4 pi rad/s to and fro). A request ends the present
procedure. A request for a state that the axis cannot enter leaves it idle. The emulated axis has an encoder without
index and no end stop. Firmware 0.6 is assumed to do the same; it reports the outcome in Procedure_Result.
"""

from __future__ import annotations

IDLE, CLOSED_LOOP = 1, 8
_STARTUP, _FULL_CALIBRATION, _MOTOR_CALIBRATION, _OFFSET_CALIBRATION, _HOMING = 2, 3, 4, 7, 11
_SECONDS = {_MOTOR_CALIBRATION: 4.25, 6: 4.0, _OFFSET_CALIBRATION: 9.0, 9: 4.0, 10: 4.0}
"""Duration of each procedure, s. Index search (6), lock-in spin (9) and direction search (10) are a lock-in spin."""
SUCCESS, BUSY, CANCELLED, DISARMED, NO_ENDSTOP, INVALID_STATE, NOT_CALIBRATED = 0, 1, 2, 3, 12, 13, 14
"""Values of Procedure_Result."""


class Procedures:
    """The procedures that an axis runs after a request for a state. result: the value of Procedure_Result."""

    def __init__(self) -> None:
        self.result = SUCCESS
        self._steps: list[int] = []
        self._until = 0.0

    @property
    def state(self) -> int:
        """The state of the axis: that of the present procedure, or idle."""
        return self._steps[0] if self._steps else IDLE

    def begin(self, state: int, now: float, *, calibrated: bool) -> None:
        """End the present procedure, and begin the procedures of `state` at `now`, s. calibrated: whether motor and
        encoder are.
        """
        running, self._steps = bool(self._steps), []
        if state in {IDLE, CLOSED_LOOP, _STARTUP}:  # no startup procedure is configured
            self.result = CANCELLED if running and state == IDLE else SUCCESS
        elif state == _FULL_CALIBRATION:
            self._steps = [_MOTOR_CALIBRATION, _OFFSET_CALIBRATION]
        elif state not in _SECONDS:
            self.result = NO_ENDSTOP if state == _HOMING else INVALID_STATE
        elif calibrated or state == _MOTOR_CALIBRATION:
            self._steps = [state]
        else:
            self.result = NOT_CALIBRATED
        if self._steps:
            self.result, self._until = BUSY, now + _SECONDS[self.state]

    def proceed(self, now: float) -> bool:
        """Begin the next procedure if the present one has ended at `now`, s. Return whether that completes a
        calibration.
        """
        calibrated = False
        while self._steps and now >= self._until:
            calibrated |= self._steps.pop(0) == _OFFSET_CALIBRATION
            self._until += _SECONDS.get(self.state, 0.0)
            self.result = BUSY if self._steps else SUCCESS
        return calibrated
