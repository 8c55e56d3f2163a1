"""Mend what a logger did to its readings: stamps that begin anew or are out of order, numbers without their sign."""
