"""Doubts about a result: what the recording cannot identify or distinguish, and what the model lacks."""
