"""Average Kc and Bc over the models that the data cannot decide between."""
