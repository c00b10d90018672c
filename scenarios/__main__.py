"""python -m scenarios list | run NAME [options]."""

import sys

import click
import typer

import cosim

from . import resonance, run_up

SCENARIOS = {"resonance": resonance, "run_up": run_up}

app = typer.Typer(add_completion=False, rich_markup_mode=None, no_args_is_help=True)
runner = typer.Typer(rich_markup_mode=None, no_args_is_help=True, help="Run a scenario.")
app.add_typer(runner, name="run")
for name, module in SCENARIOS.items():
    runner.command(name)(module.run)


@app.command("list")
def list_() -> None:
    """List the scenarios and the questions they answer."""
    for name, module in SCENARIOS.items():
        print(f"{name:<12} {(module.run.__doc__ or '').strip()}")


def main() -> int:
    """Exit code 0, 1 for a run that failed on the way, 2 for bad input, 130 after Ctrl-C."""
    try:
        return int(app(standalone_mode=False) or 0)
    except (cosim.SetupError, click.ClickException) as error:
        message = error.format_message() if isinstance(error, click.ClickException) else error
        print(f"error: {message}", file=sys.stderr)
        return 2
    except cosim.SimulationError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except (KeyboardInterrupt, click.Abort) as interrupt:
        print(f"interrupted: what was computed is kept {interrupt}".rstrip(), file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
