"""What the board says, and what the computer makes of it."""

from dataclasses import asdict, dataclass, field
from typing import Any

Fact = dict[str, Any]
NOT_SHOWN = "not shown here: "


@dataclass
class Row:
    """A check. passed: None where it could not be looked at; text: figures, in words."""

    what: str
    passed: bool | None
    text: str
    figures: Fact = field(default_factory=dict)

    def as_json(self) -> Fact:
        """As `ugrbl selftest --json` writes it."""
        return asdict(self)
