"""The command `drive-fmus`: what is installed, and where the FMUs are."""

from cosim import __version__

from .fmu_files import FMUS

COMMANDS = """\
scenarios   ask a question about a drive, and get an answer with its error:  scenarios list
cosim       couple any FMUs, and judge what a coupling computes:             cosim --help
fmukit      build an FMU from a page of equations:                           fmukit --help
"""


def main() -> int:
    """Print the version, the commands, and the folder of the FMUs with their number by flavour."""
    flavours = {"native": FMUS / "native", "Python": FMUS}
    counts = {name: len(list(folder.glob("*.fmu"))) for name, folder in flavours.items()}
    built = " and ".join(f"{count} {name}" for name, count in counts.items() if count)
    print(f"drive-fmus {__version__}\n\n{COMMANDS}")
    print(f"{built} FMUs in {FMUS}" if built else f"There are no FMUs in {FMUS} yet.")
    return 0
