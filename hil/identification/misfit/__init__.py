"""Test whether a model describes its recording, and how the misfit changes Kc and Bc."""
