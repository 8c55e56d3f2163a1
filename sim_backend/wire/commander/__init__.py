"""An emulated SimpleFOC board."""
