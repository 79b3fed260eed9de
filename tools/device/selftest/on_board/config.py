"""Parameters from the computer: program.py puts the real CONFIG in place of this one."""

from typing import Any

CONFIG: dict[str, Any] = {}
