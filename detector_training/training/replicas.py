"""One training step on several CPUs: each works through its share of the batch by itself.

Torch's own threads meet at a barrier in every operation, so on a machine that does other things too
the slowest of them sets the pace hundreds of times a step. Replicas of the net that share their
parameters meet once a step instead (measured on two cores that others used too: torch's own two
threads took 4 pictures a second, one thread 10, two replicas 13).
"""

from __future__ import annotations

import copy
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType

import torch
from torch import nn

from detector_training.training.batches import Batch
from detector_training.training.gradient import backward_part
from detector_training.training.loss import Loss
from edge_service.detector.net import TargetNet


class Replicas:
    """Computes gradients of a net with ``workers`` threads; a context manager that ends them.

    The result depends on the number of workers (each norms its own share), not on their timing.
    """

    def __init__(self, net: TargetNet, workers: int, bfloat16: bool) -> None:
        self._net = net
        self._others = [_sharing(net) for _ in range(workers - 1)]
        self._bfloat16 = bfloat16
        self._norms_learn = any(isinstance(m, nn.BatchNorm2d) and m.training for m in net.modules())
        self._threads_before = torch.get_num_threads()
        torch.set_num_threads(1)
        self._pool = ThreadPoolExecutor(workers, "replica", torch.set_num_threads, (1,))

    def __enter__(self) -> Replicas:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the threads and give torch back its own."""
        self._pool.shutdown()
        torch.set_num_threads(self._threads_before)

    def backward(self, batch: Batch) -> Loss:
        """Leave the batch's gradient in the net's parameters; the parts' losses are averaged."""
        replicas = [self._net, *self._others][: len(batch.truths)]
        images = batch.images.tensor_split(len(replicas))
        ends = [0]
        for part in images:
            ends.append(ends[-1] + len(part))
        for replica in replicas:
            replica.zero_grad(set_to_none=True)
        jobs = [
            self._pool.submit(
                backward_part, replica, part, batch.truths[a:b], len(batch.truths), self._bfloat16
            )
            for replica, part, a, b in zip(replicas, images, ends, ends[1:], strict=False)
        ]
        losses = [job.result() for job in jobs]
        self._gather(replicas)
        return Loss(*(torch.stack(parts).sum() for parts in zip(*losses, strict=True)))

    @torch.no_grad()
    def _gather(self, replicas: list[TargetNet]) -> None:
        """Sum the gradients, average the norms' statistics, and hand those out again."""
        if len(replicas) > 1:
            for same in zip(*(r.parameters() for r in replicas), strict=True):
                gradients = [p.grad for p in same if p.grad is not None]
                same[0].grad = torch.stack(gradients).sum(0) if gradients else None
        if len(replicas) > 1 and self._norms_learn:
            for buffers in zip(*(r.buffers() for r in replicas), strict=True):
                if buffers[0].dtype.is_floating_point:
                    buffers[0].copy_(torch.stack(buffers).mean(0))
        for other in self._others:
            for mine, theirs in zip(self._net.buffers(), other.buffers(), strict=True):
                theirs.copy_(mine)


def _sharing(net: TargetNet) -> TargetNet:
    """A copy with gradients and norm statistics of its own, but the very same parameters."""
    other = copy.deepcopy(net)
    for mine, theirs in zip(net.parameters(), other.parameters(), strict=True):
        theirs.data = mine.data
    return other
