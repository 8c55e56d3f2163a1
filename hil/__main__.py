"""`python -m hil`."""

from hil.cli.app import main

main()
