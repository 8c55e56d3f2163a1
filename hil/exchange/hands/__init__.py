"""Export of an identified hand into the model of a simulator."""
