"""What the computer tells the board: program.py puts the real one in place of this."""

from typing import Any

CONFIG: dict[str, Any] = {}
