"""The entry point of `python -m hil`."""

from hil.cli import main

main()
