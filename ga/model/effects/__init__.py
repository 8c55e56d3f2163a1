"""The effects that a model of the coupling can have. The table finds the records that the modules here state."""
