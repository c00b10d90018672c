"""Numbers and truth values as texts, by the lexical rules of XML Schema rather than by those of Python.

Python also reads 1_5, Arabic digits and True, and reads no 1e400 without making it infinite.
"""

from __future__ import annotations

import math
import re

#: What XML counts as white space around a value.
BLANKS = " \t\r\n"
WHOLE = re.compile(r"[+-]?[0-9]+")
REAL = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
#: The numbers that are none.
SPECIAL = {"INF": math.inf, "+INF": math.inf, "-INF": -math.inf, "NaN": math.nan}
FALSE_TRUE = {"false": False, "0": False, "true": True, "1": True}
#: Digits of a whole number. A convention: Python takes no longer ones by default, and no type has half as many.
LONGEST_NUMBER = 4000


def real(text: str) -> float:
    """The number of an xs:double, "0.5", "1e-3" or "INF"; raises ValueError for other texts."""
    text = text.strip(BLANKS)
    if text in SPECIAL:
        return SPECIAL[text]
    if REAL.fullmatch(text) is None:
        raise ValueError(f"{text!r} is not a number, written as 0.5 or 1e-3")
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"{text!r} is too large for a 64-bit floating-point number")
    return number


def whole(text: str) -> int:
    """The number of an xs:integer, "12" or "-3"; raises ValueError for other texts."""
    text = text.strip(BLANKS)
    if WHOLE.fullmatch(text) is None or len(text) > LONGEST_NUMBER:
        raise ValueError(f"{text[:40]!r} is not a whole number, written as 12 or -3")
    return int(text)


def truth(text: str) -> bool:
    """The value of an xs:boolean, "true", "false", "1" or "0"; raises ValueError for other texts."""
    text = text.strip(BLANKS)
    if text not in FALSE_TRUE:
        raise ValueError(f"{text[:40]!r} is not true or false")
    return FALSE_TRUE[text]
