"""The drive state machine of an emulated CiA 402 device: controlword in, state and statusword out.

Source: CiA 402-2, "Power drive system finite state automaton". Switching the power stage on takes `SWITCHING` s.
"""

from __future__ import annotations

import math
from enum import IntEnum

SWITCHING = 1e-3


class Cia402State(IntEnum):
    """The states, by the bits of the statusword that say so."""

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


VOLTAGE = 0x10
REMOTE = 0x200
"""Bits of the statusword: the power stage has voltage; the drive obeys the bus."""
_LIMITING = 0x800
_WITH_VOLTAGE = {Cia402State.SWITCHED_ON, Cia402State.OPERATION_ENABLED, Cia402State.QUICK_STOP_ACTIVE}


class Cia402Machine:
    """One drive's state. quick_stop_holds: whether it stays in QUICK_STOP_ACTIVE (option codes 5 to 8)."""

    def __init__(self) -> None:
        self.state = Cia402State.SWITCH_ON_DISABLED
        self.limiting = False
        self.quick_stop_holds = True
        self.ignores_controlword = False
        """The power stage does not obey."""
        self.can_reset = True
        self._controlword = 0
        self._switching = math.inf

    @property
    def statusword(self) -> int:
        """0x6041."""
        word = int(self.state) | REMOTE
        if self.state in _WITH_VOLTAGE:
            word |= VOLTAGE
        return word | (_LIMITING if self.limiting else 0)

    def due(self) -> float:
        """Return the time at which the power stage will have been switched on, s; infinity where it is not being."""
        return self._switching

    def advance(self, now: float) -> None:
        """Switch the power stage on when its time has come."""
        if self._switching <= now:
            self._switching = math.inf
            self._follow(self._controlword, math.inf)

    def fail(self) -> None:
        """Latch a fault."""
        self._switching = math.inf
        self.state = Cia402State.FAULT

    def quick_stop(self) -> None:
        """Transition 11, then 12 where it does not hold."""
        if self.state in {Cia402State.OPERATION_ENABLED, Cia402State.QUICK_STOP_ACTIVE}:
            self.state = Cia402State.QUICK_STOP_ACTIVE if self.quick_stop_holds else Cia402State.SWITCH_ON_DISABLED
        elif self.state in {Cia402State.READY_TO_SWITCH_ON, Cia402State.SWITCHED_ON}:
            self.state = Cia402State.SWITCH_ON_DISABLED
        self._switching = math.inf

    def disable_voltage(self) -> None:
        """Transitions 7, 9, 10 and 12."""
        if self.state not in {Cia402State.FAULT, Cia402State.FAULT_REACTION, Cia402State.NOT_READY}:
            self.state = Cia402State.SWITCH_ON_DISABLED
        self._switching = math.inf

    def command(self, word: int, now: float) -> bool:
        """Obey a controlword; return whether it was a fault reset that worked."""
        rising = word & ~self._controlword & 0x80
        self._controlword = word
        if self.ignores_controlword:
            return False
        if rising and self.state == Cia402State.FAULT:
            if self.can_reset:
                self.state = Cia402State.SWITCH_ON_DISABLED
            return self.can_reset
        self._follow(word, now)
        return False

    def _follow(self, word: int, now: float) -> None:
        """Obey a controlword's low bits; `now` is infinite where the power stage has been switched on."""
        if self.state in {Cia402State.FAULT, Cia402State.FAULT_REACTION, Cia402State.NOT_READY}:
            return
        if not word & 0x02:
            self.disable_voltage()
        elif not word & 0x04:
            self.quick_stop()
        elif self.state == Cia402State.QUICK_STOP_ACTIVE:
            if word & 0x0F == 0x0F:
                self.state = Cia402State.OPERATION_ENABLED
        elif not word & 0x01:
            self.state = Cia402State.READY_TO_SWITCH_ON
            self._switching = math.inf
        elif self.state == Cia402State.READY_TO_SWITCH_ON and math.isfinite(now):
            self._switching = min(self._switching, now + SWITCHING)
        elif self.state in {Cia402State.READY_TO_SWITCH_ON, Cia402State.SWITCHED_ON, Cia402State.OPERATION_ENABLED}:
            self.state = Cia402State.OPERATION_ENABLED if word & 0x08 else Cia402State.SWITCHED_ON
