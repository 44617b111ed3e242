"""The command line: the verbs by their names. Each verb imports the heavy rooms that it needs."""

from __future__ import annotations

from vsgdesign.execution.signals import End, signals_end, signals_end_for_good

with signals_end():  # Ctrl-C while modules are loaded is one line, too
    from typing import Any

    import click

    from vsgdesign import __version__
    from vsgdesign.verbs.cli.campaigns import comply, size, survive, verify
    from vsgdesign.verbs.cli.common import streams_can_print
    from vsgdesign.verbs.cli.estimator import estimator
    from vsgdesign.verbs.cli.explore import explore
    from vsgdesign.verbs.cli.export import export, pil
    from vsgdesign.verbs.cli.inputs import grid, new
    from vsgdesign.verbs.cli.run import cite, compare, diff, inner, run, simulate, validate
    from vsgdesign.verbs.cli.stability import certify, design, margins, report
    from vsgdesign.verbs.cli.table import table

    class _Program(click.Group):
        """The verbs. Before a verb begins and after it has ended, a signal ends the process with one line."""

        def __call__(self, *args: Any, **kwargs: Any) -> Any:
            end = End()
            if not args and not kwargs:  # this is the program, and no caller goes on after it
                signals_end_for_good(end)
            return self.main(*args, obj=end, **kwargs)

        def main(self, *args: Any, **kwargs: Any) -> Any:
            with signals_end(kwargs.setdefault("obj", End())):
                streams_can_print()
                return super().main(*args, **kwargs)

    @click.group(cls=_Program, context_settings={"help_option_names": ["-h", "--help"]})
    @click.version_option(__version__, prog_name="vsgdesign")
    def main() -> None:
        """From a converter's datasheet to a gain schedule for grid-forming control, proven in EMT simulation.

        Exit codes: 0 done, 1 the study asks for something impossible, 2 wrong input, 130 interrupted.
        """

    for _verb in (
        *(run, simulate, design, margins, report, certify, validate),
        *(cite, compare, comply, diff, estimator, explore, export, grid, inner, new, pil, size, survive, table, verify),
    ):
        main.add_command(_verb)

if __name__ == "__main__":
    main()
