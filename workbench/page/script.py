"""Scripts of a page as the browser gets them."""

from __future__ import annotations

import re


def compact(text: str) -> str:
    """Return a script without indents, empty lines and lines of comments.

    No string of it may go over several lines.
    """
    return re.sub(r"(?m)^\s*(//.*)?\n?", "", text)
