"""What a wrong name in a message is answered with: the names that there are, and the one that is nearest."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterable
from difflib import get_close_matches

#: Names up to which a message lists all. A convention: they fill a few lines of a screen.
MOST_LISTED = 40
#: The nearest names that it lists of more. A convention: names of so many variables are long.
NEAREST = 12
#: Names of many that are compared in full. A convention: they take a tenth of a second.
MOST_COMPARED = 1024


def only(wrong: object, names: Iterable[str]) -> str:
    """The words "only a, b" of what there is, of many the nearest, and "; did you mean b?" where a name is near."""
    known = [*dict.fromkeys(names)]
    listed, more = known, ""
    if len(known) > MOST_LISTED:
        listed = get_close_matches(str(wrong), _alike(str(wrong), known), NEAREST, 0.0)
        more = f" and {len(known) - NEAREST} more"
    return f"only {', '.join(listed) or 'none'}{more}{meant(wrong, known)}"


def meant(wrong: object, names: Iterable[str]) -> str:
    """The words "; did you mean b?" where a name is near, in whatever letters, else nothing."""
    by_lower = {name.lower(): name for name in names}
    lower = str(wrong).lower()
    near = get_close_matches(lower, _alike(lower, by_lower), 1)
    return f"; did you mean {by_lower[near[0]]}?" if near else ""


def _alike(wrong: str, names: Collection[str]) -> Collection[str]:
    """The names themselves, or of very many those that begin or end most like the wrong one."""
    if len(names) <= MOST_COMPARED:
        return names
    alike: dict[str, None] = {}
    for backwards in (1, -1):
        read = [name[::backwards] for name in names]
        read.sort()
        k = max(bisect_left(read, wrong[::backwards]) - MOST_COMPARED // 4, 0)
        alike |= dict.fromkeys(name[::backwards] for name in read[k : k + MOST_COMPARED // 2])
    return alike
