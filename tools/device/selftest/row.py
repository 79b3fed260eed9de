"""A row of the self-test's result."""

from dataclasses import asdict, dataclass, field
from typing import Any

Fact = dict[str, Any]
NOT_SHOWN = "not shown here: "


@dataclass
class Row:
    """The result of one check. passed: None if it could not be checked. text: figures in words."""

    what: str
    passed: bool | None
    text: str
    figures: Fact = field(default_factory=dict)

    def as_json(self) -> Fact:
        """Return the row for `ugrbl selftest --json`."""
        return asdict(self)
