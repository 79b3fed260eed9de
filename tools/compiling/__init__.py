"""From the firmware's sources to what goes on a board: the same program, on less; and back.

A constant of another module, a call between viper functions, a long name: on a desktop they cost
nothing, on a board memory and microseconds. So the sources are written to be read, and these
passes, one after the other, write what a board has more use for. Each takes the sources of all
modules by name, and returns them; the tests let both forms do the same things. build.py says which
of them a board needs, and has them compiled, or takes them out of stock.py; decode.py finds the
sources' names and lines again.

Imports `boardfile`.
"""

from collections.abc import Collection, Mapping

from . import marks
from .bundle import Bundles, bundle
from .inline import inline
from .leaves import leaves
from .order import order
from .prune import prune
from .shorten import Shortened, shorten


def prepared(
    sources: Mapping[str, str],
    debug: bool = False,
    with_leaves: bool = True,
    placed: Mapping[str, str] | None = None,
) -> Shortened:
    """The modules, by name, as they are to be compiled. debug: names stay as they are.
    with_leaves: viper functions stand where they are called. placed: what inline() has made of
    them already."""
    found = marks.read(sources)
    texts = inline(sources) if placed is None else placed
    texts = prune(leaves(texts, found) if with_leaves else texts)
    return Shortened(texts, {}, {}, {}, {}) if debug else shorten(texts, found)


def put_together(texts: Mapping[str, str], needed: Collection[str]) -> Bundles:
    """Those modules, as prepared() has made them, that a board needs: one for each package."""
    made = bundle({name: text for name, text in texts.items() if name in needed})
    return made._replace(texts=order(made.texts))
