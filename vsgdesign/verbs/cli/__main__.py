"""``python -m vsgdesign.verbs.cli``: the program."""

from vsgdesign.verbs.cli.program import main

main()
