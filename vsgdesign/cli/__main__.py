"""``python -m vsgdesign.cli``: the program."""

from vsgdesign.cli.program import main

main()
