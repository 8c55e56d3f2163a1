"""The entry point of `python -m hil`."""

from hil.cli.app import main

main()
