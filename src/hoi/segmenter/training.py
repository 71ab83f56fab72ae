"""Train the network: resumable at any checkpoint, the same on every run of one machine.

Phase one trains the decoder on the detector's frozen features; phase two lets the backbone learn
as well, slowly. The weights that ship are a running average. A GPU is used where there is one.
"""

from __future__ import annotations

import copy
import logging
import pickle
import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from hoi.errors import AssetError
from hoi.segmenter.config import TrainConfig
from hoi.segmenter.network import SegmentationNetwork, load_backbone
from hoi.segmenter.restoring import SUFFIX, calibrate, restored
from hoi.segmenter.samples import Batch, SampleSet

log = logging.getLogger(__name__)
_COARSE_WEIGHT = 0.4
_QUEUED = 4  # batches made ahead
_CALIBRATION_BATCHES = 12  # for the batch norms of weights that ship


@dataclass(frozen=True)
class Phase:
    """A stretch of training with its own learning rate, which falls along half a cosine."""

    name: str
    steps: int
    rate: float
    backbone_rate: float


def phases(config: TrainConfig) -> list[Phase]:
    """The phases that have steps."""
    share = config.backbone_share
    both = [
        Phase("decoder", config.decoder_steps, config.rate, 0.0),
        Phase("whole", config.whole_steps, config.whole_rate, config.whole_rate * share),
    ]
    return [phase for phase in both if phase.steps]


def mask_loss(logits: Tensor, target: Tensor) -> Tensor:
    """Cross-entropy, heavier at edges, plus Dice; logits and target (B, 1, H, W)."""
    logits = logits.float()
    size = 9 if target.shape[-1] > 50 else 3
    near = F.avg_pool2d(target, size, 1, size // 2, count_include_pad=False)
    weight = 1 + 4 * (target - near).abs()
    entropy = F.binary_cross_entropy_with_logits(logits, target, reduction="none")
    chance = logits.sigmoid()
    common = (chance * target).sum((1, 2, 3))
    dice = 1 - (2 * common + 1) / (chance.sum((1, 2, 3)) + target.sum((1, 2, 3)) + 1)
    return (2 * (weight * entropy).mean((1, 2, 3)) / 1.25 + dice).mean()


def total_loss(outputs: tuple[Tensor, Tensor], target: Tensor) -> Tensor:
    """Of the final and of the coarse mask."""
    final, coarse = outputs
    small = F.adaptive_avg_pool2d(target, (coarse.shape[2], coarse.shape[3]))
    return mask_loss(final, target) + _COARSE_WEIGHT * mask_loss(coarse, small)


def train(
    samples: SampleSet,
    config: TrainConfig,
    seed: int,
    nanodet: Path,
    checkpoint: Path,
    stop_after: int | None = None,
    watch: Callable[[int, SegmentationNetwork], None] | None = None,
) -> SegmentationNetwork:
    """Train, or go on from `checkpoint`; returns the averaged network.

    Args:
        samples: what to learn from.
        nanodet: the converted detector, for the backbone's weights.
        checkpoint: written every `save_every` steps and at the end. One of other settings or
            another seed is not continued but replaced.
        stop_after: leave off after so many steps of this call (an interrupted run).
        watch: called with the step and the averaged network at every checkpoint.
    """
    device = _device(config)
    torch.manual_seed(seed)
    identity = {"config": config.model_dump(mode="json", exclude={"device", "workers"})}
    identity |= {"seed": seed, "samples": len(samples.samples)}
    state = _read(checkpoint, identity, device)
    if state is None:
        network = start_network(config, nanodet, samples, seed)
    else:
        network = SegmentationNetwork()  # filled below
    network = network.to(device)
    network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = copy.deepcopy(network).eval().requires_grad_(False)
    done = 0
    if state is not None:
        network.load_state_dict(state["network"])
        average.load_state_dict(state["average"])
        done = state["step"]
        log.info("going on from step %d", done)
    total = sum(phase.steps for phase in phases(config))
    last = total if stop_after is None else min(total, done + stop_after)
    plan = _Plan(config, total)
    batches = _batches(samples, config, seed, plan, done, last)
    optimiser, owner = None, None
    losses: list[float] = []
    for step, batch in zip(range(done, last), batches, strict=False):
        phase, within = plan.at(step)
        if owner is not phase:
            optimiser, owner = _optimiser(network, phase, config), phase
            if state is not None and state["phase"] == phase.name:
                optimiser.load_state_dict(state["optimiser"])
            state = None
        assert optimiser is not None
        _set_rates(optimiser, phase, within, config)
        network.train()
        inputs = [torch.from_numpy(part).to(device) for part in batch]
        with _mixed(device):
            outputs = network(inputs[0].contiguous(memory_format=torch.channels_last), inputs[1])
        loss = total_loss(outputs, inputs[2])
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        _follow(average, network, min(config.averaging, 1 - 1 / (step + 1)))
        losses.append(float(loss.detach()))
        if (step + 1) % config.save_every == 0 or step + 1 == last:
            log.info("step %d of %d: loss %.3f", step + 1, total, np.mean(losses))
            losses.clear()
            _write(checkpoint, identity, step + 1, phase, network, average, optimiser)
            if watch is not None:
                watch(step + 1, average)
    return average.cpu()


def start_network(
    config: TrainConfig, nanodet: Path, samples: SampleSet, seed: int
) -> SegmentationNetwork:
    """An untrained decoder on the detector's backbone, or the network of `config.init`."""
    if config.init is None:
        return SegmentationNetwork(load_backbone(nanodet))
    if config.init.endswith(SUFFIX):
        network = restored(config.init)
        steps = range(_CALIBRATION_BATCHES)
        sizes = config.batch, config.side, config.used_share
        calibrate(network, (samples.batch(seed + 1, step, *sizes) for step in steps))
        return network
    network = SegmentationNetwork()
    network.load_state_dict(read_weights(Path(config.init)))
    return network


def read_weights(path: Path) -> dict[str, Tensor]:
    """The averaged weights in a checkpoint; raises AssetError when there are none."""
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, ValueError, pickle.UnpicklingError) as error:
        raise AssetError(f"{path} is no checkpoint: {error}") from error
    return stored.get("average", stored)


class _Plan:
    """Which phase a step belongs to, and how large its crops are."""

    def __init__(self, config: TrainConfig, total: int):
        self.config, self.total = config, total
        self.phases = phases(config)

    def at(self, step: int) -> tuple[Phase, int]:
        first = 0
        for phase in self.phases:
            if step < first + phase.steps:
                return phase, step - first
            first += phase.steps
        raise IndexError(step)

    def side(self, step: int) -> int:
        return self.config.side if step < self.total / 2 else self.config.late_side


def _batches(
    samples: SampleSet, config: TrainConfig, seed: int, plan: _Plan, first: int, last: int
) -> Iterator[Batch]:
    """The batches of some steps in order, made ahead by threads."""

    def make(step: int) -> Batch:
        return samples.batch(seed, step, config.batch, plan.side(step), config.used_share)

    if config.workers == 0:
        yield from map(make, range(first, last))
        return
    slots: list[queue.Queue] = [queue.Queue(_QUEUED) for _ in range(config.workers)]
    stop = threading.Event()

    def work(number: int) -> None:
        for step in range(first + number, last, config.workers):
            try:
                made: Batch | Exception = make(step)
            except Exception as error:  # handed to the consumer, who raises it
                made = error
            while not stop.is_set():
                try:
                    slots[number].put(made, timeout=0.5)
                    break
                except queue.Full:
                    continue
            if stop.is_set():
                return

    threads = [threading.Thread(target=work, args=(n,), daemon=True) for n in range(config.workers)]
    for thread in threads:
        thread.start()
    try:
        for step in range(first, last):
            made = slots[(step - first) % config.workers].get()
            if isinstance(made, Exception):
                raise made
            yield made
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def _device(config: TrainConfig) -> torch.device:
    if config.device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    return torch.device(config.device)


def _mixed(device: torch.device) -> Any:
    """Half precision where it is fast: on GPUs, and on processors that multiply bfloat16."""
    fast = device.type == "cuda" or _has_bfloat16()
    return torch.autocast(device.type, torch.bfloat16, enabled=fast)


def _has_bfloat16() -> bool:
    try:
        flags = Path("/proc/cpuinfo").read_text()
    except OSError:
        return False
    return "avx512_bf16" in flags or "amx_bf16" in flags


def _optimiser(
    network: SegmentationNetwork, phase: Phase, config: TrainConfig
) -> torch.optim.Optimizer:
    if phase.backbone_rate > 0:
        network.train_backbone_too()
    else:
        network.train_only_decoder()
    backbone = [p for p in network.backbone.parameters() if p.requires_grad]
    decoder = [p for name, p in network.named_parameters() if not name.startswith("backbone.")]
    groups = [{"params": decoder, "top": phase.rate}]
    if backbone:
        groups.append({"params": backbone, "top": phase.backbone_rate})
    return torch.optim.AdamW(groups, lr=phase.rate, weight_decay=config.weight_decay)


def _set_rates(
    optimiser: torch.optim.Optimizer, phase: Phase, within: int, config: TrainConfig
) -> None:
    rise = min(1.0, (within + 1) / config.warmup)
    fall = 0.02 + 0.98 * 0.5 * (1 + np.cos(np.pi * within / phase.steps))
    for group in optimiser.param_groups:
        # numpy's numbers would keep the checkpoint from being read back without pickled code
        group["lr"] = float(group["top"] * rise * fall)


@torch.no_grad()
def _follow(average: SegmentationNetwork, network: SegmentationNetwork, keep: float) -> None:
    current = network.state_dict()
    for name, value in average.state_dict().items():
        if value.dtype.is_floating_point:
            value.lerp_(current[name], 1 - keep)
        else:
            value.copy_(current[name])


def _read(checkpoint: Path, identity: dict, device: torch.device) -> dict | None:
    if not checkpoint.is_file():
        return None
    try:
        state = torch.load(checkpoint, map_location=device, weights_only=True)
    except Exception as error:  # whatever a damaged file makes torch raise, training can restart
        log.warning("%s cannot be read (%s); training starts again", checkpoint, error)
        return None
    if state.get("identity") != identity:
        log.warning("%s is of other settings; training starts again", checkpoint)
        return None
    return state


def _write(
    checkpoint: Path,
    identity: dict,
    step: int,
    phase: Phase,
    network: SegmentationNetwork,
    average: SegmentationNetwork,
    optimiser: torch.optim.Optimizer,
) -> None:
    checkpoint.parent.mkdir(parents=True, exist_ok=True)
    partial = checkpoint.with_name(checkpoint.name + ".partial")
    state = {
        "identity": identity,
        "step": step,
        "phase": phase.name,
        "network": network.state_dict(),
        "average": average.state_dict(),
        "optimiser": optimiser.state_dict(),
    }
    torch.save(state, partial)
    partial.replace(checkpoint)
