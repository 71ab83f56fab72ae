"""Minimise a method's objective for all hypotheses of a frame in one batch [3.4].

Hypotheses never influence each other: every step length, line search and restart is per
hypothesis, so that a hypothesis ends where it would have ended alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from hoi.joint.config import Schedule, TermName
from hoi.joint.problem import Problem
from hoi.joint.terms import SCALE_BLIND, weighted_terms

_LOG_SCALE = 9  # column of the variables


@dataclass(frozen=True)
class Evaluated:
    """Objective at one point: total (K,), infinite where not finite; gradient (K, D), zero there;
    weighted terms (T, K)."""

    total: Tensor
    gradient: Tensor
    terms: Tensor


Objective = Callable[[Tensor], Evaluated]
#: (S,) factors of the starts' scales -> (S, K) what these depths cost besides the loss.
DepthCost = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Optimum:
    """Where the optimisation ended.

    Attributes:
        variables: (K, D) the best point each hypothesis has seen. total: (K,), infinite for a
            hypothesis that never had a finite loss. terms: (T, K) weighted.
        curves: (iterations + 1, T, K) weighted terms along the way.
    """

    variables: Tensor
    total: Tensor
    terms: Tensor
    curves: Tensor


def objective_of(problem: Problem, terms: Mapping[TermName, float]) -> Objective:
    """The objective of a method on one frame, with its gradient."""

    def evaluate(variables: Tensor) -> Evaluated:
        variables = variables.detach().requires_grad_()
        values = weighted_terms(problem, terms, variables)
        (gradient,) = torch.autograd.grad(values.sum(), variables)
        return _finite(values.detach(), gradient)

    return evaluate


def _finite(terms: Tensor, gradient: Tensor) -> Evaluated:
    total = terms.sum(0)
    good = torch.isfinite(total) & torch.isfinite(gradient).all(1)
    total = torch.where(good, total, torch.inf)
    return Evaluated(total, torch.where(good[:, None], gradient, 0.0), terms)


def minimise(
    problem: Problem,
    terms: Mapping[TermName, float],
    schedule: Schedule,
    depth_cost: DepthCost | None = None,
) -> Optimum:
    """Depth grid, then the schedule's optimiser, from `problem.start`."""
    start = problem.start
    if schedule.depth_grid > 1:
        steps, span = schedule.depth_grid, schedule.depth_grid_range
        start = best_depth(problem, terms, steps, span, depth_cost)
    objective = objective_of(problem, terms)
    run = adam if schedule.optimiser == "adam" else lbfgs
    return run(objective, start, schedule)


def best_depth(
    problem: Problem,
    terms: Mapping[TermName, float],
    steps: int,
    span: float,
    depth_cost: DepthCost | None = None,
) -> Tensor:
    """Variables (K, D) with the log scale of the lowest loss among `steps` within +-`span`.

    Scaling about the camera centre moves no pixel, so this is a search along the viewing ray, and
    the silhouette terms need not be computed. `depth_cost` adds what has no gradient to follow:
    an object that starts on the wrong side of the person seldom finds the way through.
    """
    seen: dict[TermName, float] = {
        name: weight for name, weight in terms.items() if name not in SCALE_BLIND
    }
    if not seen:
        return problem.start
    offsets = torch.linspace(-span, span, steps)
    with torch.no_grad():
        losses = []
        for offset in offsets:
            variables = problem.start.clone()
            variables[:, _LOG_SCALE] += offset
            losses.append(weighted_terms(problem, seen, variables).sum(0))
        table = torch.nan_to_num(torch.stack(losses), nan=torch.inf)
        if depth_cost is not None:
            table = table + depth_cost(offsets.exp())
        # of equal losses the one nearest to the size prior
        best = (table + 1e-9 * offsets.abs()[:, None]).argmin(0)
    start = problem.start.clone()
    start[:, _LOG_SCALE] += offsets[best]
    return start


def adam(objective: Objective, start: Tensor, schedule: Schedule) -> Optimum:
    """Adam; a hypothesis without a finite gradient stands still. Keeps the best point seen."""
    variables = start.clone().requires_grad_()
    optimiser = torch.optim.Adam([variables], lr=schedule.learning_rate)
    best = _Best(start)
    for iteration in range(schedule.iterations):
        evaluated = objective(variables)
        best.see(variables.detach(), evaluated)
        if schedule.decay:
            left = 1 - iteration / schedule.iterations
            optimiser.param_groups[0]["lr"] = schedule.learning_rate * max(left, 0.05)
        variables.grad = evaluated.gradient
        optimiser.step()
    best.see(variables.detach(), objective(variables))
    return best.optimum()


_MEMORY = 8
_SUFFICIENT = 1e-4  # Armijo's share of the predicted decrease
_SHORTER = 0.4
_LONGEST = 0.1  # of any variable in one step: radians, metres and log scale alike
_SHORTEST = 1e-3  # of a step before the memory is dropped
_FIRST = 0.01


def lbfgs(objective: Objective, start: Tensor, schedule: Schedule) -> Optimum:
    """Limited-memory BFGS with one backtracking line search per hypothesis, all in one batch.

    One iteration is one evaluation of the batch: some hypotheses accept their step, others try a
    shorter one. The loss of a hypothesis never rises. A step that leads to a value that is not
    finite is shortened like one that does not decrease the loss.
    """
    hypotheses, dimensions = start.shape
    steps = torch.zeros(_MEMORY, hypotheses, dimensions)
    changes = torch.zeros(_MEMORY, hypotheses, dimensions)
    inverse = torch.zeros(_MEMORY, hypotheses)
    variables, here = start.clone(), objective(start)
    best = _Best(start)
    best.see(variables, here)
    direction = _steepest(here.gradient)
    length = torch.ones(hypotheses)
    for _ in range(schedule.iterations):
        trial = variables + length[:, None] * direction
        there = objective(trial)
        slope = (here.gradient * direction).sum(1)
        accept = there.total <= here.total + _SUFFICIENT * length * slope
        step, change = trial - variables, there.gradient - here.gradient
        curvature = (step * change).sum(1)
        learn = accept & (curvature > 1e-10)
        steps = _pushed(steps, step, learn)
        changes = _pushed(changes, change, learn)
        inverse = _pushed(inverse, 1 / curvature.clamp(min=1e-10), learn)
        variables = torch.where(accept[:, None], trial, variables)
        here = Evaluated(
            torch.where(accept, there.total, here.total),
            torch.where(accept[:, None], there.gradient, here.gradient),
            torch.where(accept[None], there.terms, here.terms),
        )
        best.see(variables, here)
        stuck = ~accept & (length < _SHORTEST)
        inverse = torch.where(stuck[None], torch.zeros(()), inverse)
        fresh = _quasi_newton(here.gradient, steps, changes, inverse)
        direction = torch.where((accept | stuck)[:, None], fresh, direction)
        length = torch.where(accept | stuck, torch.ones(()), length * _SHORTER)
    return best.optimum()


def _pushed(memory: Tensor, value: Tensor, where: Tensor) -> Tensor:
    """`memory` (M, K, ...) with `value` (K, ...) as newest entry of the hypotheses in `where`."""
    shifted = torch.cat([memory[1:], value[None]])
    return torch.where(where.reshape(1, -1, *[1] * (memory.ndim - 2)), shifted, memory)


def _steepest(gradient: Tensor) -> Tensor:
    largest = gradient.abs().amax(1, keepdim=True).clamp(min=1e-12)
    return -_FIRST * gradient / largest


def _quasi_newton(gradient: Tensor, steps: Tensor, changes: Tensor, inverse: Tensor) -> Tensor:
    """Two-loop recursion for all hypotheses; entries with zero `inverse` are empty."""
    weights = []
    direction = gradient
    for step, change, rho in zip(steps.flip(0), changes.flip(0), inverse.flip(0), strict=True):
        weight = rho * (step * direction).sum(1)
        direction = direction - weight[:, None] * change
        weights.append(weight)
    squared = changes[-1].square().sum(1)
    known = (inverse[-1] > 0) & (squared > 0)
    scale = torch.where(known, 1 / (inverse[-1] * squared).clamp(min=1e-20), torch.ones(()))
    direction = direction * scale[:, None]
    for step, change, rho, weight in zip(steps, changes, inverse, reversed(weights), strict=True):
        back = rho * (change * direction).sum(1)
        direction = direction + (weight - back)[:, None] * step
    direction = -direction
    downhill = (direction * gradient).sum(1) < 0
    usable = known & downhill & torch.isfinite(direction).all(1)
    direction = torch.where(usable[:, None], direction, _steepest(gradient))
    largest = direction.abs().amax(1, keepdim=True).clamp(min=1e-12)
    return direction * (_LONGEST / largest).clamp(max=1)


class _Best:
    """The best point that each hypothesis has seen, and the curves of all terms."""

    def __init__(self, start: Tensor):
        self.variables = start.clone()
        self.total = torch.full((len(start),), torch.inf)
        self.terms: Tensor | None = None
        self.curves: list[Tensor] = []

    def see(self, variables: Tensor, evaluated: Evaluated) -> None:
        self.curves.append(evaluated.terms)
        better = evaluated.total < self.total
        self.variables = torch.where(better[:, None], variables, self.variables)
        self.total = torch.where(better, evaluated.total, self.total)
        old = evaluated.terms if self.terms is None else self.terms
        self.terms = torch.where(better[None], evaluated.terms, old)

    def optimum(self) -> Optimum:
        assert self.terms is not None
        return Optimum(self.variables, self.total, self.terms, torch.stack(self.curves))
