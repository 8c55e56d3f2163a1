"""Doubts about a result: what the recording does not identify or distinguish, and what the model lacks."""
