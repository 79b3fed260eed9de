"""Checks for `$NET/NAME=VALUE`. net_access.py imports this only when a value is set."""

from micropython import const

_DIGITS = "0123456789"
_LETTERS = "abcdefghijklmnopqrstuvwxyz"
_HOST_CHARACTERS = _LETTERS + _DIGITS + "-"
_LONGEST_HOST = const(31)
_LONGEST_NAME = const(32)
_SHORTEST_PASSWORD = const(8)
_LONGEST_PASSWORD = const(63)
_HIGHEST_PORT = const(65535)


def change(values: "dict[str, str]", text: str) -> str:
    """Change the stored values. Return "", or what is wrong, and then change nothing.

    values: by name; SSID and PASS are stored as hexadecimal digits. text: `NAME=VALUE`;
    `PASS+VALUE` continues a password; `OFF` removes the network's name, password and mode. An
    access point always has a password: without one, strangers could join it.
    """
    name, sign, value = _split(text)
    if name == "OFF" and not sign:
        for removed in ("SSID", "PASS", "MODE"):
            values.pop(removed, None)
        return ""
    # Shown if the name or the sign is none of these.
    problem = "$NET/SSID= PASS= MODE=STATION MODE=AP HOST= PORT= KEY OFF"
    if name == "SSID" and sign == "=":
        problem = _check_hex(value, fewest=1, most=_LONGEST_NAME)
    elif name == "PASS" and sign:
        value = (values.get("PASS", "") if sign == "+" else "") + value
        problem = _check_hex(value, fewest=0, most=_LONGEST_PASSWORD)
    elif name == "MODE" and sign == "=" and value in ("STATION", "AP"):
        problem = ""
        value = value.lower()
    elif name == "HOST" and sign == "=":
        value = value.lower()
        problem = _check_host(value)
    elif name == "PORT" and sign == "=":
        problem = _check_port(value)
    if problem:
        return problem
    changed = dict(values)
    changed[name] = value
    # Two hexadecimal digits per letter.
    if changed.get("MODE") == "ap" and len(changed.get("PASS", "")) < 2 * _SHORTEST_PASSWORD:
        return "With MODE=AP, PASS must have 8 letters or more"
    values[name] = value
    return ""


def _check_hex(text: str, fewest: int, most: int) -> str:
    """Return "" if the text is that many bytes as hexadecimal digits, else what it must be."""
    try:
        count = len(bytes.fromhex(text))
    except ValueError:
        count = -1
    if fewest <= count <= most:
        return ""
    return "The value must be %d to %d bytes in hexadecimal" % (fewest, most)


def _check_host(text: str) -> str:
    """Return "" if the text is a host name, else what it must be."""
    if _has_only(text, _HOST_CHARACTERS) and text[0] != "-" and len(text) <= _LONGEST_HOST:
        return ""
    return "A host name may have up to 31 letters, digits and -"


def _check_port(text: str) -> str:
    """Return "" if the text is a port's number, else what it must be."""
    if _has_only(text, _DIGITS) and 0 < int(text) <= _HIGHEST_PORT:
        return ""
    return "A port is a number from 1 to 65535"


def _split(text: str) -> "tuple[str, str, str]":
    """Split `NAME=VALUE`, `NAME+VALUE` or `NAME` into name, sign and value; "" without a sign."""
    for sign in "=+":
        name, found, value = text.partition(sign)
        if found and _has_only(name.lower(), _LETTERS):
            return name, sign, value
    return text, "", ""


def _has_only(text: str, allowed: str) -> bool:
    """Return whether the text is not empty and has only these characters."""
    return bool(text) and not [character for character in text if character not in allowed]
