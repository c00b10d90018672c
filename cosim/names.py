"""What a wrong name in a message is answered with: the names that there are, and the one that is nearest."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

#: Names up to which a message lists all. A convention: they fill a few lines of a screen.
MOST_LISTED = 40
#: The nearest names that it lists of more. A convention: names of so many variables are long.
NEAREST = 12


def only(wrong: object, names: Iterable[str]) -> str:
    """The words "only a, b" of what there is, of many the nearest, and "; did you mean b?" where a name is near."""
    known = [*dict.fromkeys(names)]
    listed, more = known, ""
    if len(known) > MOST_LISTED:
        listed = get_close_matches(str(wrong), known, NEAREST, 0.0)
        more = f" and {len(known) - NEAREST} more"
    return f"only {', '.join(listed) or 'none'}{more}{meant(wrong, known)}"


def meant(wrong: object, names: Iterable[str]) -> str:
    """The words "; did you mean b?" where a name is near, in whatever letters, else nothing."""
    by_lower = {name.lower(): name for name in names}
    near = get_close_matches(str(wrong).lower(), by_lower, 1)
    return f"; did you mean {by_lower[near[0]]}?" if near else ""
