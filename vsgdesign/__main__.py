"""``python -m vsgdesign``: the program."""

from vsgdesign.verbs.cli.program import main

main()
