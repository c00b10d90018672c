"""Where the FMUs of a question come from: folders by flavour, and what fills them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cosim import SetupError

SUFFIX = ".fmu"


@dataclass(frozen=True)
class Library:
    """Folders of FMUs by flavour; `fill` makes FMUs of these names and flavour that are missing or
    out of date, and raises SetupError with the reason where it cannot.
    """

    folders: Mapping[str, Path]
    fill: Callable[[Sequence[str], str], None] | None = None

    def paths(self, parts: Mapping[str, str], flavour: str, beside: Path) -> dict[str, Path]:
        """The FMU of each part: one of the library by its name, or any by its path from `beside`.

        Raises SetupError for an FMU that is not there.
        """
        own = [fmu for fmu in dict.fromkeys(parts.values()) if not fmu.endswith(SUFFIX)]
        if own and self.fill:
            self.fill(own, flavour)
        found = {}
        for part, fmu in parts.items():
            folder = self.folders[flavour] if fmu in own else beside
            found[part] = folder / (f"{fmu}{SUFFIX}" if fmu in own else fmu)
            if not found[part].is_file():
                there = ", ".join(sorted(path.stem for path in folder.glob(f"*{SUFFIX}")))
                raise SetupError(
                    f"PARTS: {part} = {fmu!r}: no file {found[part]}; in its folder: {there or 'none'}"
                )
        return found
