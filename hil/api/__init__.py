"""The functions that `import hil` offers, over which the command line is a thin layer."""
