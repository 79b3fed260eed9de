"""What is looked for in the memory of a board: where MicroPython keeps what."""

from types import SimpleNamespace

import pytest
from ports import usb_ring


@pytest.mark.parametrize(
    ("code", "begins", "is_known"),
    [
        (0x2000_4000, 0xB09E_B5FE, True),
        (0x2008_0010, 0xB084_B5B1, True),
        (0x2000_4000, 0x0000, False),
        (0x1003_0000, 0xB5FE, False),
    ],
)
def test_a_micropython_that_keeps_functions_otherwise_is_refused_before_it_is_called(
    monkeypatch: pytest.MonkeyPatch, code: int, begins: int, is_known: bool
) -> None:
    class Words:
        def __getitem__(self, address: int) -> int:
            return begins if address == code else code

    memory = SimpleNamespace(mem32=Words())
    monkeypatch.setattr(usb_ring, "machine", memory)
    if is_known:
        usb_ring.check_calls()
    else:
        with pytest.raises(RuntimeError, match="another MicroPython"):
            usb_ring.check_calls()
