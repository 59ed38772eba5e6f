"""Numbers and names in sentences."""

from __future__ import annotations

from collections.abc import Sequence

#: Names that are written out; of longer lists the first ones are.
NAMED = 8


def count(number: int, noun: str) -> str:
    """A number with its noun.

    Examples:
        >>> count(1, "state"), count(2, "state")
        ('1 state', '2 states')
    """
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def enumerate_names(names: Sequence[str], most: int = NAMED) -> str:
    """Join names as a sentence does.

    Examples:
        >>> enumerate_names(("a", "b", "c"))
        'a, b and c'
        >>> enumerate_names("abcdefghij")
        'a, b, c, d, e, f, g, h and 2 more'
    """
    shown = list(names[:most])
    if len(names) > most:
        shown.append(f"{len(names) - most} more")
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"
