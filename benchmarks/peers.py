"""Other people's ways to draw a silhouette and get its gradient, for the silhouette benchmark.

- :class:`PyTorch3D`: its CPU rasteriser, from the installed package or compiled from a checkout;
  `hard` takes the nearest face and no blur, `soft` is SoftSilhouetteShader's 50 faces with blur.
- :func:`soft_rasteriser`: SoftRas (Liu et al., ICCV 2019) as plain torch code: every pixel against
  every face.
- :func:`nmr_gradient`: the approximate gradient of the Neural 3D Mesh Renderer (Kato et al., CVPR
  2018), written anew after the paper: for every edge, rows and columns are swept to the nearest
  pixels whose change the edge would cause. Only outline edges are swept, which favours it.
"""

from __future__ import annotations

import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numba as nb
import numpy as np
import torch
from torch import Tensor

from hoi.rendering import MeshTopology, SilhouetteTarget, kernels, render_silhouette

BLUR = math.log(1 / 1e-4 - 1) * 1e-4  # of PyTorch3D's SoftSilhouetteShader tutorials
SOFT_SIGMA = 1e-4
_BINDING = """
#include <torch/extension.h>
#include "rasterize_meshes/rasterize_meshes.h"
PYBIND11_MODULE(TORCH_EXTENSION_NAME, m) {
  m.def("forward", &RasterizeMeshesNaiveCpu);
  m.def("backward", &RasterizeMeshesBackwardCpu);
}
"""


class PyTorch3D:
    """PyTorch3D's naive CPU rasteriser."""

    def __init__(self, module: Any):
        self._forward = getattr(module, "forward", None) or module._rasterize_meshes_naive
        self._backward = getattr(module, "backward", None) or module.rasterize_meshes_backward

    @classmethod
    def find(cls, checkout: Path | None) -> tuple[PyTorch3D | None, str]:
        """The rasteriser, or nothing and why; `checkout` is a clone of PyTorch3D to compile."""
        try:
            from pytorch3d import _C  # type: ignore[import-not-found]

            return cls(_C), "installed pytorch3d"
        except ImportError as error:
            if checkout is None:
                return None, f"pytorch3d is not installed ({error}); see --pytorch3d"
        return cls(_compiled(checkout)), f"rasteriser compiled from {checkout.name}"

    def loss_and_gradient(
        self, xy: Tensor, topology: MeshTopology, target: SilhouetteTarget, soft: bool
    ) -> Tensor:
        """d(loss)/d(xy) of sum (S - M)^2 for xy (B, V, 2)."""
        height, width = target.shape
        half = torch.tensor([width / 2, height / 2])
        screen = torch.cat([-(xy - half) / half, torch.ones_like(xy[..., :1])], dim=-1)
        faces = screen[:, torch.from_numpy(topology.faces).long()].reshape(-1, 3, 3).contiguous()
        count = len(topology.faces)
        first, number = torch.arange(len(xy)) * count, torch.full((len(xy),), count)
        unclipped = torch.full((len(faces),), -1, dtype=torch.int64)
        nearest, depth, barycentric, distance = self._forward(
            faces, first, number, unclipped, (height, width), BLUR if soft else 0.0,
            50 if soft else 1, False, False, False,
        )  # fmt: skip
        distance.requires_grad_()
        found = nearest >= 0
        sharpness = SOFT_SIGMA if soft else 1e-6
        clear = torch.where(found, torch.sigmoid(distance / sharpness), 1.0).prod(-1)
        wanted = torch.from_numpy(target.mask)
        loss = (1 - clear - wanted).square().sum()
        (pull,) = torch.autograd.grad(loss, distance)
        return self._backward(
            faces, nearest, torch.zeros_like(depth), torch.zeros_like(barycentric), pull, False,
            False,
        )  # fmt: skip


def soft_rasteriser(
    xy: Tensor, faces: Tensor, mask: Tensor, pixels: slice, sigma: float = 0.5
) -> Tensor:
    """Loss of some pixels of one mesh: probability of each face, aggregated as a soft or.

    Args:
        xy: (V, 2) pixels. faces: (F, 3). mask: (H, W). pixels: of the flattened image.
    """
    height, width = mask.shape
    index = torch.arange(height * width)[pixels]
    centre = torch.stack([index % width, index // width], dim=-1) + 0.5
    a = xy[faces]
    side = a.roll(-1, 1) - a
    towards = centre[:, None, None] - a[None]
    share = (towards * side).sum(-1) / (side.square().sum(-1) + 1e-9)
    apart = (towards - share.clamp(0, 1)[..., None] * side).square().sum(-1).amin(-1)
    turn = side[..., 0] * towards[..., 1] - side[..., 1] * towards[..., 0]
    inside = (turn > 0).all(-1) | (turn < 0).all(-1)
    signed = torch.where(inside, apart, -apart)
    drawn = 1 - torch.exp(torch.nn.functional.logsigmoid(-signed / sigma).sum(-1))
    return (drawn - mask.reshape(-1)[pixels]).square().sum()


def nmr_gradient(xy: Tensor, topology: MeshTopology, target: SilhouetteTarget) -> np.ndarray:
    """Approximate d(loss)/d(xy) (B, V, 2) of sum (S - M)^2, hard silhouettes."""
    images = render_silhouette(xy, topology, *target.shape, antialias=False).numpy()
    points = xy.numpy()
    grad = np.zeros_like(points)
    mesh = kernels.Mesh(topology.faces, topology.edges, topology.edge_faces)
    _nmr_batch(points, mesh, images, target.mask, grad)
    return grad


@nb.njit
def _nmr_batch(points, mesh, images, mask, grad):
    height, width = mask.shape
    sign = np.empty(mesh.faces.shape[0], np.int8)
    chosen = np.empty(mesh.edges.shape[0] + 1, np.int32)
    multiplicity = np.empty(mesh.edges.shape[0] + 1, np.int16)
    for k in range(points.shape[0]):
        kernels._orient_faces(points[k], mesh.faces, sign)
        count = kernels._outline_edges(mesh.edges, mesh.edge_faces, sign, chosen, multiplicity)
        for i in range(count):
            e = chosen[i]
            for axis in range(2):
                _nmr_edge(
                    points[k], mesh.edges[e, 0], mesh.edges[e, 1], axis, images[k], mask, grad[k],
                    width if axis == 0 else height, height if axis == 0 else width,
                )  # fmt: skip


@nb.njit
def _nmr_edge(xy, i, j, axis, image, mask, grad, cells, lines):
    """Sweep every line that one edge crosses, from the edge to both borders."""
    along, across = axis, 1 - axis
    a0, a1, b0, b1 = xy[i, along], xy[i, across], xy[j, along], xy[j, across]
    low, high = min(a1, b1), max(a1, b1)
    for line in range(max(math.ceil(low - 0.5), 0), min(math.ceil(high - 0.5), lines)):
        share = (line + 0.5 - a1) / (b1 - a1)
        position = a0 + share * (b0 - a0) - 0.5
        left = math.floor(position)
        for way in (-1, 1):
            beside = left if way == 1 else left + 1
            start = left + 1 if way == 1 else left
            if beside < 0 or beside >= cells:
                continue
            own = image[line, beside] if axis == 0 else image[beside, line]
            c = start
            while 0 <= c < cells:
                r, q = (line, c) if axis == 0 else (c, line)
                change = own - image[r, q]
                if change != 0:
                    gain = 2 * (image[r, q] - mask[r, q]) * change
                    if gain < 0:  # moving the edge here lowers the loss
                        pull = gain / (c - position)
                        grad[i, along] += pull * (1 - share)
                        grad[j, along] += pull * share
                c += way


def _compiled(checkout: Path) -> ModuleType:
    """Only the two files that the CPU rasteriser needs; under a minute."""
    from torch.utils.cpp_extension import _get_build_directory, load

    folder = Path(_get_build_directory("pytorch3d_cpu_rasteriser", verbose=False))
    binding = folder / "binding.cpp"
    if not binding.is_file() or binding.read_text() != _BINDING:
        binding.write_text(_BINDING)
    csrc = checkout / "pytorch3d" / "csrc"
    return load(
        "pytorch3d_cpu_rasteriser",
        [str(binding), str(csrc / "rasterize_meshes" / "rasterize_meshes_cpu.cpp")],
        extra_include_paths=[str(csrc)],
        extra_cflags=["-O3"],
    )
