"""Documents: files of a vendor's own objects that `robot-gateway validate` checks, row by row, without a robot.

Here is what a document type is and what a check answers; what a document holds is the vendor's business.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import msgspec

LARGEST = 64 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong.

    Args:
        path: Where: `target.joints[3]`; empty for the whole.
        message: What is wrong and what is allowed, in words.
        found: What stands there, shortened; empty where nothing does.
        allowed: What may stand there; empty where that is more than a phrase.
    """

    path: str
    message: str
    found: str = ""
    allowed: str = ""

    def __str__(self) -> str:
        return f"{self.path}: {self.message}" if self.path else self.message


@dataclass(frozen=True, slots=True)
class Row:
    """One object of a document.

    Args:
        cells: What people recognise it by, a text for each column of the document type.
        problems: All that is wrong with it; none: it is good.
    """

    cells: tuple[str, ...]
    problems: tuple[Problem, ...] = ()


@dataclass(frozen=True, slots=True)
class Checked:
    """What came of a document.

    Args:
        rows: Its objects, in the order of the file.
        problems: What is wrong with the document itself, or with parts of it that are no row.
    """

    rows: tuple[Row, ...] = ()
    problems: tuple[Problem, ...] = ()

    @property
    def n_wrong(self) -> int:
        """How many rows have problems."""
        return sum(bool(row.problems) for row in self.rows)

    @property
    def good(self) -> bool:
        """Nothing at all is wrong."""
        return not self.problems and not self.n_wrong


@dataclass(frozen=True, slots=True, kw_only=True)
class DocumentType:
    """One kind of document of a vendor.

    Args:
        name: Short lower-case name, for `--type`.
        title: One line for people: what it holds and which forms a file may have.
        noun: What a row is: "command object"; with an s where there are several.
        columns: Headings of the cells of a row.
        check: Reads the bytes of a file; the struct is one of `options`. It raises nothing, whatever the bytes are.
        options: A frozen msgspec struct of what a check may be told; every field has a default.
        schema: Makes the JSON Schema (2020-12) of the document.
        largest: Size of a file above which it is not read, in bytes.
    """

    name: str
    title: str
    noun: str
    columns: tuple[str, ...]
    check: Callable[[bytes, msgspec.Struct], Checked]
    options: type[msgspec.Struct]
    schema: Callable[[], dict[str, object]]
    largest: int = LARGEST

    def counted(self, number: int) -> str:
        """So many rows, in words."""
        return f"{number} {self.noun}{'' if number == 1 else 's'}"
