"""Which tests run, and how many cases of similar ones.

The first ring (`make test`) answers in minutes: it leaves out tests marked `thorough`, and runs
three cases of a test marked `sampled(3)`. The second (`make test-all`, pytest --all) runs
everything that needs neither an image nor a sender; of a test marked `sampled(3, 20)`, and of what
sample(cases, 3, 20) chooses, 20 cases. All of these, too, run each night (`make test-all WHOLE=1`,
pytest --whole). One seed, shown in the summary, chooses the samples and hypothesis' examples.
"""

import os
import random
import zlib
from collections import defaultdict
from collections.abc import Sequence
from typing import TypeVar

import pytest

_Item = TypeVar("_Item")

_ring: "dict[str, int]" = {"all": 0, "whole": 0, "seed": 0}


def add_options(parser: pytest.Parser) -> None:
    """Add pytest's options for rings."""
    group = parser.getgroup("rings")
    group.addoption("--all", action="store_true", help="the second ring: all there is")
    group.addoption("--whole", action="store_true", help="and of what it samples all cases")
    group.addoption("--seed", type=int, help="which samples and examples to take")
    group.addoption("--shard", help="2/5: the second of five parts of the tests")


def choose(config: pytest.Config) -> None:
    """Set ring and seed, before any module of tests is imported. Workers inherit the seed."""
    if config.option.seed is None:
        chosen = os.environ.setdefault("UGRBL_SEED", str(random.randrange(10_000)))
        config.option.seed = int(chosen)
    if config.getoption("--hypothesis-seed") is None:
        config.option.hypothesis_seed = str(config.option.seed)
    whole = config.option.whole
    _ring.update(all=is_second(config), whole=whole, seed=config.option.seed)


def is_second(config: pytest.Config) -> bool:
    """Return whether all tests are requested; works before choose()."""
    return bool(config.option.all or config.option.whole)


def is_first() -> bool:
    """Return whether samples are enough."""
    return not _ring["all"]


def is_whole() -> bool:
    """Return whether nothing is sampled."""
    return bool(_ring["whole"])


def sample(items: "Sequence[_Item]", first: int, second: "int | None" = None) -> "list[_Item]":
    """Return `first` items in the first ring and `second` in the second, in order. None: all."""
    count = first if is_first() else second
    if count is None or is_whole() or len(items) <= count:
        return list(items)
    chosen = random.Random(f"{_ring['seed']} {len(items)}").sample(range(len(items)), count)
    return [items[index] for index in sorted(chosen)]


def select(config: pytest.Config, items: "list[pytest.Item]") -> None:
    """Deselect what the ring or the shard leaves out."""
    kept = set(_of_ring(items))
    if config.option.shard:
        part, parts = map(int, config.option.shard.split("/"))
        kept = {item for item in kept if zlib.crc32(item.nodeid.encode()) % parts == part - 1}
    left_out = [item for item in items if item not in kept]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item in kept]


def _of_ring(items: "list[pytest.Item]") -> "list[pytest.Item]":
    """Return the ring's items: samples of sampled tests, thorough tests only in the second
    ring."""
    kept = []
    alike: "dict[str, list[pytest.Item]]" = defaultdict(list)
    counts: "dict[str, tuple[int, ...]]" = {}
    for item in items:
        # The closest mark counts: a test of a thorough module may be sampled.
        marks = (mark for mark in item.iter_markers() if mark.name in ("thorough", "sampled"))
        mark = next(marks, None)
        if mark is not None and mark.name == "sampled":
            name = item.nodeid.partition("[")[0]
            alike[name].append(item)
            counts[name] = mark.args
        elif mark is None or not is_first():
            kept.append(item)
    for name, cases in alike.items():
        kept += sample(cases, *counts[name])
    return kept


def summary(config: pytest.Config) -> str:
    """Return a line that says what runs, and how to repeat it."""
    whole = ", whole" if is_whole() else ""
    ring = "first" if is_first() else f"second{whole}, shard {config.option.shard or '1/1'}"
    return f"ring: {ring}, --seed={config.option.seed}"
