"""The command line: the only package that prints, reads from the terminal, or exits."""
