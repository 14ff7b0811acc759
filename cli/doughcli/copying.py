"""What merge, subset and split share: where the new dataset lies, a bar, and what is said after."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from doughcli.options import emit_json

if TYPE_CHECKING:
    from doughdata.dataset.transfer import Copied

__all__ = ["IntoOption", "copying", "report_copy"]

IntoOption = Annotated[
    str, typer.Option("--into", metavar="URI", help="Where the new dataset is made.")
]


@contextmanager
def copying(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar from the first scene on; yields what hears how far it is."""
    from doughcli.progress import StageBars

    with ExitStack() as stack:
        bars: StageBars | None = None
        before = 0

        def heard(done: int, total: int) -> None:
            nonlocal bars, before
            if bars is None:
                bars = stack.enter_context(StageBars())
                bars.start(what, total=total, done=0)
            bars.advance(what, done - before)
            before = done

        yield heard


def report_copy(copied: "Copied", *, as_json: bool) -> None:
    """Print what was made."""
    from dataclasses import asdict

    if as_json:
        emit_json(asdict(copied))
        return
    there = f", {copied.kept} layers of shards were there" if copied.kept else ""
    print(f"{copied.dataset}: {copied.scenes} scenes in {copied.shards} shards{there}")
