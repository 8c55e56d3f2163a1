"""Doubts about a result: what the recording cannot identify or distinguish, and which effects the model lacks."""
