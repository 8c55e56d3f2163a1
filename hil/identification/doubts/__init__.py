"""Doubts about a result: what the recording does not identify, and what it cannot distinguish."""
