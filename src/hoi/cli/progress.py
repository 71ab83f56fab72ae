"""How far a run is, on the terminal: stage, frames, seconds left."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from hoi.cli.engine import Event, Finished, Planned, Started

#: Seconds that one job of a rule takes for one photo on a quiet core, to weigh what is left.
SECONDS = {
    "exemplars": 20.0, "models": 30.0, "kernels": 25.0, "photos": 2.0, "detect": 5.0,
    "smplify": 5.0, "objectfit": 7.0, "actions": 2.0, "priors": 1.0, "joint": 6.0,
    "scenes": 6.0, "page": 5.0, "gallery": 3.0,
}  # fmt: skip
_OTHER = 1.0


class Estimate:
    """What is done and what is left of a run, by the weight of its rules.

    Args:
        clock: seconds, from any origin.
    """

    def __init__(self, clock=time.monotonic):
        self._clock = clock
        self._started = clock()
        self._total = 0.0
        self._done = 0.0
        self.jobs = 0
        self.finished = 0
        self.running: dict[str, str] = {}

    def update(self, event: Event) -> None:
        """Take note of an event of the run."""
        if isinstance(event, Planned):
            self._total = sum(SECONDS.get(rule, _OTHER) * n for rule, n in event.jobs.items())
            self.jobs = sum(event.jobs.values())
            self._started = self._clock()
        elif isinstance(event, Started):
            self.running[event.job] = event.message
        elif isinstance(event, Finished):
            self.running.pop(event.job, None)
            self.finished += 1
            self._done = min(self._total, self._done + SECONDS.get(event.rule, _OTHER))

    @property
    def share(self) -> float:
        """0..1 of the run's weight that is done."""
        return self._done / self._total if self._total else 0.0

    @property
    def stage(self) -> str:
        """What runs now, in the rules' words."""
        return " · ".join(dict.fromkeys(self.running.values())) or "Planning"

    def seconds_left(self) -> float | None:
        """By the pace so far; before anything is done, by the weights; None before the plan."""
        if not self._total:
            return None
        if not self._done:
            return self._total
        return (self._clock() - self._started) * (self._total - self._done) / self._done


@contextmanager
def shown(console, frames: int) -> Iterator[Estimate]:
    """A live line on a terminal, one plain line a job elsewhere; yields what to update.

    Args:
        console: a ``rich.console.Console``.
        frames: how many photos the run is about.
    """
    from rich.live import Live
    from rich.text import Text

    estimate = Estimate()
    unit = f"{frames} photo{'s' if frames != 1 else ''}"

    class Line:
        def __rich__(self) -> Text:
            left = estimate.seconds_left()
            bar = round(24 * estimate.share)
            text = Text("━" * bar, "green")
            text.append("━" * (24 - bar), "bright_black")
            text.append(f" {100 * estimate.share:3.0f} %  ")
            text.append(f"{unit}, ", "bright_black")
            text.append("…" if left is None else f"about {left:.0f} s left", "cyan")
            text.append(f"  {estimate.stage}", "bright_black")
            text.no_wrap, text.overflow = True, "ellipsis"
            return text

    if console.is_terminal:
        with Live(Line(), console=console, refresh_per_second=4, transient=True):
            yield estimate
        return

    update = estimate.update

    def told(event: Event) -> None:
        update(event)
        if isinstance(event, Started):
            left = estimate.seconds_left() or 0.0
            place = f"[{estimate.finished + len(estimate.running)}/{estimate.jobs}]"
            console.print(
                f"{place} {event.message} (about {left:.0f} s left)", markup=False, highlight=False
            )

    estimate.update = told  # type: ignore[method-assign]
    yield estimate
