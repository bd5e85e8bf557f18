"""The net for one input shape on a CPU: weights packed once, bias and ReLU inside the convolution.

Eager PyTorch packs each convolution's weights into oneDNN's blocks anew in every run, and walks
over its output once more for the ReLU. Here both are done once, by the very kernels that it calls,
so the numbers are the same. On a net of 71 convolutions: 28.3 -> 24.2 ms in fp32, 17.4 -> 14.1 ms
in bf16 (640x480, 2 cores).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import torch
from torch import Tensor, fx, nn

Run: TypeAlias = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Logits (B, N, C) and distances (B, N, C, 4) of images (B, 3, H, W) in [0, 1]."""


class PackedConv(nn.Module):
    """A convolution whose weights lie as oneDNN wants them for one shape of input.

    Args:
        conv: what it does.
        shape: (B, C, H, W) of its input; others work as well, but slower.
        relu: whether a ReLU follows.
    """

    def __init__(self, conv: nn.Conv2d, shape: tuple[int, ...], relu: bool) -> None:
        super().__init__()
        self._bias = conv.bias
        self._padding, self._stride = list(map(int, conv.padding)), list(conv.stride)
        self._dilation, self._groups = list(conv.dilation), conv.groups
        self._after = "relu" if relu else "none"
        self._weight = torch.ops.mkldnn._reorder_convolution_weight(
            conv.weight, self._padding, self._stride, self._dilation, self._groups, list(shape)
        )

    def forward(self, x: Tensor) -> Tensor:
        """(B, c_in, H, W) to (B, c_out, H', W')."""
        y: Tensor = torch.ops.mkldnn._convolution_pointwise(
            x,
            self._weight,
            self._bias,
            self._padding,
            self._stride,
            self._dilation,
            self._groups,
            self._after,
            [],
            "",
        )
        return y


def packed(net: nn.Module, images: Tensor) -> Run | None:
    """The net for images of one shape; None: it cannot be packed, or answers otherwise then.

    Args:
        net: fused, in eval mode, of one dtype or with heads of another.
        images: (B, 3, H, W), an example in the body's dtype.
    """
    try:
        with torch.inference_mode():
            run = _rewritten(net, images)
            want, got = net(images), run(images)
    except (RuntimeError, TypeError, AttributeError, fx.proxy.TraceError):
        return None  # a build of torch without oneDNN, or a net that decides by its data
    tolerance = 1e-3 if images.dtype == torch.float32 else 0.05
    same = all(torch.allclose(g, w, tolerance, tolerance) for g, w in zip(got, want, strict=True))
    return run if same else None


def _rewritten(net: nn.Module, images: Tensor) -> Run:
    shapes = _input_shapes(net, images)
    graph = _Tracer(len(images)).trace(net)
    modules = dict(net.named_modules())
    whole = fx.GraphModule(net, graph)
    for k, node in enumerate(list(graph.nodes)):
        module = modules.get(node.target) if node.op == "call_module" else None
        if isinstance(module, nn.Identity):
            node.replace_all_uses_with(node.args[0])
            graph.erase_node(node)
        elif isinstance(module, nn.Conv2d) and module.padding_mode == "zeros":
            relu = _only_relu(node, modules)
            if relu is not None:
                relu.replace_all_uses_with(node)
                graph.erase_node(relu)
            name = f"packed_{k}"
            whole.add_submodule(name, PackedConv(module, shapes[module], relu is not None))
            node.target = name
    graph.lint()
    whole.delete_all_unused_submodules()
    whole.recompile()
    run: Run = whole.forward
    return run


def _only_relu(conv: fx.Node, modules: dict[str, nn.Module]) -> fx.Node | None:
    """The ReLU that alone takes a convolution's output, identities in between left out."""
    if len(conv.users) != 1:
        return None
    (user,) = conv.users
    if user.op == "call_module" and isinstance(modules.get(str(user.target)), nn.Identity):
        return _only_relu(user, modules) if len(user.users) == 1 else None
    is_relu = (user.op == "call_module" and isinstance(modules.get(str(user.target)), nn.ReLU)) or (
        user.op == "call_function" and user.target in (torch.relu, nn.functional.relu)
    )
    return user if is_relu else None


def _input_shapes(net: nn.Module, images: Tensor) -> dict[nn.Module, tuple[int, ...]]:
    shapes: dict[nn.Module, tuple[int, ...]] = {}

    def note(module: nn.Module, inputs: tuple[Tensor, ...]) -> None:
        shapes[module] = tuple(inputs[0].shape)

    hooks = [m.register_forward_pre_hook(note) for m in net.modules() if isinstance(m, nn.Conv2d)]
    try:
        net(images)
    finally:
        for hook in hooks:
            hook.remove()
    return shapes


class _Tracer(fx.Tracer):
    """Follows a net that asks for the length of a tensor: of all of them it is the batch."""

    def __init__(self, batch: int) -> None:
        super().__init__()
        self._batch = batch

    def proxy(self, node: fx.Node) -> fx.Proxy:
        return _Batched(node, self, self._batch)


class _Batched(fx.Proxy):
    def __init__(self, node: fx.Node, tracer: fx.Tracer, batch: int) -> None:
        super().__init__(node, tracer)
        self._batch = batch

    def __len__(self) -> int:
        return self._batch
