"""What every page needs: text that is escaped, tables, and a file written whole."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

from securestate._files import whole_file


def write_page(text: str, path: str | os.PathLike[str]) -> Path:
    """Write a page whole or not at all; returns its path.

    Raises:
        OSError: the file cannot be written; nothing is left behind.
    """
    target = Path(path)
    with whole_file(target) as part:
        part.write_text(text, encoding="utf-8", newline="\n")
    return target


def asset(*names: str) -> str:
    """The text of files that come with the package, one after the other."""
    folder = files("securestate.reporting").joinpath("assets")
    return "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in names)


def paragraphs(sentences: Iterable[str]) -> str:
    """One paragraph per sentence, escaped."""
    return "".join(f"<p>{escape(sentence)}</p>" for sentence in sentences)


def definitions(rows: Mapping[str, str]) -> str:
    """The inside of a definition list, escaped, without what is empty."""
    return "".join(f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in rows.items() if v)


def table(head: Sequence[str], rows: Iterable[str]) -> str:
    """A table of rows that are HTML already."""
    titles = "".join(f'<th scope="col">{h}</th>' for h in head)
    return f"<table><thead><tr>{titles}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def percent(share: float) -> str:
    """A share in per cent, as HTML.

    Examples:
        >>> [percent(s) for s in (0.0, 0.0001, 0.123, 0.9999, 1.0)]
        ['0 %', '&lt;0.1 %', '12.3 %', '&gt;99.9 %', '100 %']
    """
    if share in (0.0, 1.0):
        return f"{100 * share:.0f} %"
    return "&lt;0.1 %" if share < 0.001 else "&gt;99.9 %" if share > 0.999 else f"{100 * share:.1f} %"


def compact(value: float) -> str:
    """A number in few digits.

    Examples:
        >>> [compact(v) for v in (1.0, 1.234, 23.45, 456.7, 12345.0, 1e50, 0.00123, 0.0)]
        ['1.00', '1.23', '23.4', '457', '1.2e4', '1e50', '1.2e-3', '0']
        >>> compact(float("inf")), compact(float("nan"))
        ('∞', '–')
    """
    if math.isnan(value):
        return "–"
    if math.isinf(value) or value == 0:
        return "∞" if value else "0"
    if 0.01 <= abs(value) < 999.5:
        return f"{value:#.3g}".removesuffix(".")
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"
