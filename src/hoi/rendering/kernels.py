"""Numba kernels of the edge-only silhouette rasteriser and of the z-buffer.

The algorithm. Orient every projected face so that it is positive on screen; the number of faces
over a point is then the winding number of their outlines. An edge between two faces that lie on
opposite sides of it cancels, so only silhouette, boundary and non-manifold edges remain. Each of
them adds its net multiplicity where it crosses a row of pixel centres; running sums along the rows
give exact coverage at the pixel centres without touching a triangle. Anti-aliasing then blends each
pair of neighbouring pixels, one covered and one not, by where the outermost edge passes between
their centres (as the `antialias` operation of Laine et al., Modular Primitives for
High-Performance Differentiable Rendering, 2020), which makes the image differentiable in the two
end points of that edge.

All helpers live in this one file because Numba's disk cache only notices edits of the file that
holds the compiled function. Kernels use one thread and release the interpreter lock.
"""

import math
from typing import NamedTuple

import numba as nb
import numpy as np

HALF = np.float32(0.5)
ONE = np.float32(1.0)
TWO = np.float32(2.0)
# Faces that reach further than this many pixels from the image corner are left out: beyond it
# float32 no longer places a crossing within a tenth of a pixel.
FARTHEST_PIXEL = np.float32(1e6)

# Plain fast maths would let the compiler assume that no NaN exists, and with it drop the checks
# that keep NaN out; only re-association and contraction are allowed.
_SAFE_MATH = {"reassoc", "contract", "arcp", "nsz"}


class Mesh(NamedTuple):
    """The tables of a MeshTopology."""

    faces: np.ndarray
    edges: np.ndarray
    edge_faces: np.ndarray


class Target(NamedTuple):
    """The tables of a SilhouetteTarget."""

    mask: np.ndarray
    keep: np.ndarray
    edge_distance: np.ndarray
    prefix: np.ndarray
    base_loss: np.float32


class Weights(NamedTuple):
    """Of the two parts of the loss."""

    mask: np.float32
    edge: np.float32


class Scratch(NamedTuple):
    """Working memory of one call; between meshes `delta` and `change` are 0, `owner` is -1."""

    covered: np.ndarray  # (H, W) whether the pixel centre is covered
    delta: np.ndarray  # (H, W + 1) change of the winding number; wraps around harmlessly
    sign: np.ndarray  # (F,) way each face turns on screen
    chosen: np.ndarray  # (E + 1,) outline edges
    multiplicity: np.ndarray  # (E + 1,) of each chosen edge
    position: np.ndarray  # (2, H, W) where an edge separates a pixel pair
    owner: np.ndarray  # (2, H, W) that edge
    pairs: np.ndarray  # (2 H W,) the separated pairs
    change: np.ndarray  # (H, W) blended coverage minus hard coverage
    sums: np.ndarray  # (3,) prefix table summed over the silhouette


@nb.njit
def _scratch(mesh, height, width):
    return Scratch(
        np.zeros((height, width), np.uint8),
        np.zeros((height, width + 1), np.int16),
        np.empty(mesh.faces.shape[0], np.int8),
        np.empty(mesh.edges.shape[0] + 1, np.int32),
        np.empty(mesh.edges.shape[0] + 1, np.int16),
        np.empty((2, height, width), np.float32),
        np.full((2, height, width), -1, np.int32),
        np.empty(2 * height * width, np.int32),
        np.zeros((height, width), np.float32),
        np.zeros(3, np.float64),
    )


@nb.njit(fastmath=_SAFE_MATH)
def _orient_faces(xy, faces, sign):
    """sign[f] = which way face f turns on screen; 0 for a face without area or out of range."""
    for f in range(faces.shape[0]):
        i0, i1, i2 = faces[f, 0], faces[f, 1], faces[f, 2]
        x0, y0 = xy[i0, 0], xy[i0, 1]
        x1, y1 = xy[i1, 0], xy[i1, 1]
        x2, y2 = xy[i2, 0], xy[i2, 1]
        reach = max(max(abs(x0), abs(y0)), max(max(abs(x1), abs(y1)), max(abs(x2), abs(y2))))
        known = (abs(x0) + abs(y0)) + (abs(x1) + abs(y1)) + (abs(x2) + abs(y2))
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if not (reach < FARTHEST_PIXEL) or not (known < 6 * FARTHEST_PIXEL):
            sign[f] = 0
        elif area > 0:
            sign[f] = 1
        elif area < 0:
            sign[f] = -1
        else:
            sign[f] = 0


@nb.njit(fastmath=_SAFE_MATH)
def _outline_edges(edges, edge_faces, sign, chosen, multiplicity):
    """Edges whose faces do not cancel; returns how many."""
    count = 0
    for e in range(edges.shape[0]):
        net = edge_faces[e, 1] * sign[edge_faces[e, 0]] + edge_faces[e, 3] * sign[edge_faces[e, 2]]
        chosen[count] = e
        multiplicity[count] = net
        if net != 0:
            count += 1
    return count


@nb.njit(fastmath=_SAFE_MATH)
def _pixel_window(xy, edges, chosen, count, height, width):
    """Rows and columns the outline can touch, one pixel wider: first row, end row, ..., end."""
    left, top = FARTHEST_PIXEL, FARTHEST_PIXEL
    right, bottom = -FARTHEST_PIXEL, -FARTHEST_PIXEL
    for k in range(count):
        e = chosen[k]
        for i in range(2):
            x, y = xy[edges[e, i], 0], xy[edges[e, i], 1]
            left, right = min(left, x), max(right, x)
            top, bottom = min(top, y), max(bottom, y)
    row0 = min(max(math.floor(top) - 1, 0), height)
    row1 = max(min(math.ceil(bottom) + 2, height), row0)
    col0 = min(max(math.floor(left) - 1, 0), width)
    col1 = max(min(math.ceil(right) + 2, width), col0)
    return row0, row1, col0, col1


@nb.njit(fastmath=_SAFE_MATH)
def _mark_crossings(xy, edges, chosen, multiplicity, count, height, width, delta):
    """delta[r, c] += multiplicity for the first pixel centre right of each crossing of row r."""
    for k in range(count):
        e = chosen[k]
        a, b = edges[e, 0], edges[e, 1]
        xa, ya, yb = xy[a, 0], xy[a, 1], xy[b, 1]
        if ya < yb:
            low, high, net = ya, yb, -multiplicity[k]
        else:
            low, high, net = yb, ya, multiplicity[k]
        first = max(math.ceil(low - HALF), 0)
        last = min(math.ceil(high - HALF) - 1, height - 1)
        if first > last:
            continue
        slope = (xy[b, 0] - xa) / (yb - ya)
        for r in range(first, last + 1):
            x = xa + (np.float32(r) + HALF - ya) * slope - HALF
            x = min(max(x, np.float32(0)), np.float32(width))
            delta[r, math.ceil(x)] += net


@nb.njit(fastmath=_SAFE_MATH)
def _cover_rows(delta, covered, row0, row1, col0, col1, width):
    """Coverage at pixel centres inside the window; leaves delta zero again."""
    for r in range(row0, row1):
        winding = 0
        for c in range(col0, col1):
            winding += delta[r, c]
            delta[r, c] = 0
            covered[r, c] = 1 if winding > 0 else 0
        for c in range(col1, width + 1):
            delta[r, c] = 0


@nb.njit(fastmath=_SAFE_MATH)
def _sum_runs(delta, covered, prefix, row0, row1, col0, col1, width, sums):
    """As _cover_rows, and sums of the target's prefix table over the covered pixels."""
    s0, s1, s2 = 0.0, 0.0, 0.0
    for r in range(row0, row1):
        winding = 0
        before = 0
        for c in range(col0, col1):
            winding += delta[r, c]
            delta[r, c] = 0
            inside = 1 if winding > 0 else 0
            covered[r, c] = inside
            if inside != before:
                if inside == 1:
                    s0 -= prefix[r, c, 0]
                    s1 -= prefix[r, c, 1]
                    s2 -= prefix[r, c, 2]
                else:
                    s0 += prefix[r, c, 0]
                    s1 += prefix[r, c, 1]
                    s2 += prefix[r, c, 2]
                before = inside
        if before == 1:
            s0 += prefix[r, col1, 0]
            s1 += prefix[r, col1, 1]
            s2 += prefix[r, col1, 2]
        for c in range(col1, width + 1):
            delta[r, c] = 0
    sums[0] = s0
    sums[1] = s1
    sums[2] = s2


@nb.njit(fastmath=_SAFE_MATH)
def _boundary_pairs(xy, edges, chosen, count, covered, height, width, position, owner, pairs):
    """Neighbouring pixels of unlike coverage, with the outermost edge between their centres.

    Steep edges look at pixels side by side (axis 0), flat edges at pixels above each other (axis
    1). A pair is stored as ``4 * pixel + 2 * axis + coverage of its first pixel``.
    """
    found = 0
    for k in range(count):
        e = chosen[k]
        a, b = edges[e, 0], edges[e, 1]
        xa, ya, xb, yb = xy[a, 0], xy[a, 1], xy[b, 0], xy[b, 1]
        dx, dy = xb - xa, yb - ya
        if abs(dy) >= abs(dx):
            first = max(math.ceil(min(ya, yb) - HALF), 0)
            last = min(math.ceil(max(ya, yb) - HALF) - 1, height - 1)
            if first > last:
                continue
            slope = dx / dy
            for r in range(first, last + 1):
                x = xa + (np.float32(r) + HALF - ya) * slope
                c = math.floor(x - HALF)
                if c < 0 or c >= width - 1:
                    continue
                inside = np.int64(covered[r, c])
                if inside == covered[r, c + 1]:
                    continue
                if owner[0, r, c] < 0:
                    owner[0, r, c] = e
                    position[0, r, c] = x
                    pairs[found] = (r * width + c) * 4 + inside
                    found += 1
                elif (inside == 1) == (x > position[0, r, c]):
                    owner[0, r, c] = e
                    position[0, r, c] = x
        else:
            first = max(math.ceil(min(xa, xb) - HALF), 0)
            last = min(math.ceil(max(xa, xb) - HALF) - 1, width - 1)
            if first > last:
                continue
            slope = dy / dx
            for c in range(first, last + 1):
                y = ya + (np.float32(c) + HALF - xa) * slope
                r = math.floor(y - HALF)
                if r < 0 or r >= height - 1:
                    continue
                inside = np.int64(covered[r, c])
                if inside == covered[r + 1, c]:
                    continue
                if owner[1, r, c] < 0:
                    owner[1, r, c] = e
                    position[1, r, c] = y
                    pairs[found] = (r * width + c) * 4 + 2 + inside
                    found += 1
                elif (inside == 1) == (y > position[1, r, c]):
                    owner[1, r, c] = e
                    position[1, r, c] = y
    return found


@nb.njit(fastmath=_SAFE_MATH)
def _blend(pair, position, width):
    """The pixel that an edge blends and by how much: row, column, change of coverage."""
    inside = pair & 1
    axis = (pair >> 1) & 1
    pixel = pair >> 2
    r = pixel // width
    c = pixel - r * width
    along = r if axis == 1 else c
    past_border = position[axis, r, c] - np.float32(along + 1)
    change = past_border if inside == 1 else -past_border
    if past_border > 0:
        if axis == 0:
            c += 1
        else:
            r += 1
    return r, c, change


@nb.njit(fastmath=_SAFE_MATH)
def _push_edge(xy, edges, pair, owner, width, pull, grad):
    """Add d(position)/d(end points) * pull of the edge that owns a pair to grad (V, 2)."""
    axis = (pair >> 1) & 1
    pixel = pair >> 2
    r = pixel // width
    c = pixel - r * width
    e = owner[axis, r, c]
    a, b = edges[e, 0], edges[e, 1]
    dx, dy = xy[b, 0] - xy[a, 0], xy[b, 1] - xy[a, 1]
    if axis == 0:
        slope = dx / dy
        u = (np.float32(r) + HALF - xy[a, 1]) / dy
        grad[a, 0] += pull * (ONE - u)
        grad[b, 0] += pull * u
        grad[a, 1] -= pull * (ONE - u) * slope
        grad[b, 1] -= pull * u * slope
    else:
        slope = dy / dx
        u = (np.float32(c) + HALF - xy[a, 0]) / dx
        grad[a, 1] += pull * (ONE - u)
        grad[b, 1] += pull * u
        grad[a, 0] -= pull * (ONE - u) * slope
        grad[b, 0] -= pull * u * slope


@nb.njit(fastmath=_SAFE_MATH)
def _unit(value):
    return min(max(value, np.float32(0)), ONE)


@nb.njit(fastmath=_SAFE_MATH)
def _outline(points, mesh, height, width, work):
    """Choose the outline's edges and mark their crossings; edge count and pixel window."""
    _orient_faces(points, mesh.faces, work.sign)
    count = _outline_edges(mesh.edges, mesh.edge_faces, work.sign, work.chosen, work.multiplicity)
    window = _pixel_window(points, mesh.edges, work.chosen, count, height, width)
    _mark_crossings(
        points, mesh.edges, work.chosen, work.multiplicity, count, height, width, work.delta
    )
    return count, window


@nb.njit(fastmath=_SAFE_MATH)
def _separated_pairs(points, mesh, count, height, width, work):
    return _boundary_pairs(
        points, mesh.edges, work.chosen, count, work.covered, height, width, work.position,
        work.owner, work.pairs,
    )  # fmt: skip


@nb.njit(fastmath=_SAFE_MATH)
def _forget_pairs(found, width, work):
    for k in range(found):
        pixel = work.pairs[k] >> 2
        work.owner[(work.pairs[k] >> 1) & 1, pixel // width, pixel % width] = -1


@nb.njit(fastmath=_SAFE_MATH)
def _overlap(points, mesh, prefix, work):
    """Leaves the prefix table's sums over one hard silhouette in work.sums."""
    height, width = prefix.shape[0], prefix.shape[1] - 1
    _, (row0, row1, col0, col1) = _outline(points, mesh, height, width, work)
    _sum_runs(work.delta, work.covered, prefix, row0, row1, col0, col1, width, work.sums)


@nb.njit(fastmath=_SAFE_MATH)
def _compare(points, mesh, target, weights, work, grad):
    """Loss, soft intersection and soft area of one mesh; adds d(loss)/d(points) to grad (V, 2)."""
    height, width = target.mask.shape
    covered, change, position, pairs = work.covered, work.change, work.position, work.pairs
    count, (row0, row1, col0, col1) = _outline(points, mesh, height, width, work)
    _sum_runs(work.delta, covered, target.prefix, row0, row1, col0, col1, width, work.sums)
    found = _separated_pairs(points, mesh, count, height, width, work)

    mask_loss = target.base_loss + work.sums[0]
    shared, own = work.sums[1], work.sums[2]
    for k in range(found):
        r, c, amount = _blend(pairs[k], position, width)
        hard = np.float32(covered[r, c])
        old = _unit(hard + change[r, c])
        change[r, c] += amount
        new = _unit(hard + change[r, c])
        keep, wanted = target.keep[r, c], target.mask[r, c]
        mask_loss += keep * (new - old) * (new + old - TWO * wanted)
        shared += keep * (min(new, wanted) - min(old, wanted))
        own += keep * (new - old)

    edge_loss = 0.0
    for k in range(found):
        pair = pairs[k]
        r, c, _ = _blend(pair, position, width)
        blended = _unit(np.float32(covered[r, c]) + change[r, c])
        direction = ONE if pair & 1 == 1 else -ONE
        pull = TWO * target.keep[r, c] * (blended - target.mask[r, c]) * direction

        axis = (pair >> 1) & 1
        r0 = (pair >> 2) // width
        c0 = (pair >> 2) - r0 * width
        r1, c1 = (r0, c0 + 1) if axis == 0 else (r0 + 1, c0)
        distance = target.edge_distance[r0, c0]
        slack = target.edge_distance[r1, c1] - distance
        keep = min(target.keep[r0, c0], target.keep[r1, c1])
        fraction = position[axis, r0, c0] - np.float32(c0 if axis == 0 else r0) - HALF
        edge_loss += keep * (distance + fraction * slack)
        total_pull = weights.mask * pull + weights.edge * keep * slack
        _push_edge(points, mesh.edges, pair, work.owner, width, total_pull, grad)
    for k in range(found):
        r, c, _ = _blend(pairs[k], position, width)
        change[r, c] = 0
    _forget_pairs(found, width, work)
    return weights.mask * mask_loss + weights.edge * edge_loss, shared, own


@nb.njit(fastmath=_SAFE_MATH)
def _place(vertices, linear, shift, intrinsics, near, points):
    """Image coordinates (V, 2) of ``vertices @ linear.T + shift``; depth clamped to near."""
    fx, fy = intrinsics[0, 0], intrinsics[1, 1]
    cx, cy = intrinsics[0, 2], intrinsics[1, 2]
    for v in range(vertices.shape[0]):
        a, b, c = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        z = max(linear[2, 0] * a + linear[2, 1] * b + linear[2, 2] * c + shift[2], near)
        x = linear[0, 0] * a + linear[0, 1] * b + linear[0, 2] * c + shift[0]
        y = linear[1, 0] * a + linear[1, 1] * b + linear[1, 2] * c + shift[1]
        inverse = ONE / z
        points[v, 0] = x * inverse * fx + cx
        points[v, 1] = y * inverse * fy + cy


@nb.njit(fastmath=_SAFE_MATH)
def _pull_back(vertices, linear, shift, intrinsics, near, points, grad, linear_grad, shift_grad):
    """Chain d(loss)/d(points) to the placement, written over the two last; zeroes grad."""
    fx, fy = intrinsics[0, 0], intrinsics[1, 1]
    cx, cy = intrinsics[0, 2], intrinsics[1, 2]
    linear_grad[:] = 0
    shift_grad[:] = 0
    for v in range(vertices.shape[0]):
        gu, gv = grad[v, 0], grad[v, 1]
        if gu == 0 and gv == 0:
            continue
        grad[v, 0] = 0
        grad[v, 1] = 0
        a, b, c = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        z = linear[2, 0] * a + linear[2, 1] * b + linear[2, 2] * c + shift[2]
        inverse = ONE / max(z, near)
        gx, gy = gu * fx * inverse, gv * fy * inverse
        gz = np.float32(0)
        if z > near:
            gz = -(gu * (points[v, 0] - cx) + gv * (points[v, 1] - cy)) * inverse
        shift_grad[0] += gx
        shift_grad[1] += gy
        shift_grad[2] += gz
        linear_grad[0, 0] += gx * a
        linear_grad[0, 1] += gx * b
        linear_grad[0, 2] += gx * c
        linear_grad[1, 0] += gy * a
        linear_grad[1, 1] += gy * b
        linear_grad[1, 2] += gy * c
        linear_grad[2, 0] += gz * a
        linear_grad[2, 1] += gz * b
        linear_grad[2, 2] += gz * c


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def loss_and_gradient(xy, mesh, target, weights, loss, intersection, area, grad):
    """Fused loss, soft overlap and gradient of B meshes against one target; grad starts at zero."""
    height, width = target.mask.shape
    work = _scratch(mesh, height, width)
    for b in range(xy.shape[0]):
        loss[b], intersection[b], area[b] = _compare(xy[b], mesh, target, weights, work, grad[b])


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def pose_loss_and_gradient(
    vertices, linear, shift, intrinsics, near, mesh, target, weights,
    loss, intersection, area, linear_grad, shift_grad,
):  # fmt: skip
    """As loss_and_gradient for one mesh at B placements, gradient to the placements."""
    height, width = target.mask.shape
    work = _scratch(mesh, height, width)
    points = np.empty((vertices.shape[0], 2), np.float32)
    grad = np.zeros((vertices.shape[0], 2), np.float32)
    for b in range(linear.shape[0]):
        _place(vertices, linear[b], shift[b], intrinsics, near, points)
        loss[b], intersection[b], area[b] = _compare(points, mesh, target, weights, work, grad)
        _pull_back(
            vertices, linear[b], shift[b], intrinsics, near, points, grad, linear_grad[b],
            shift_grad[b],
        )  # fmt: skip


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def overlap(xy, mesh, prefix, intersection, area):
    """Weighted intersection with the target and own area of B silhouettes, hard coverage."""
    work = _scratch(mesh, prefix.shape[0], prefix.shape[1] - 1)
    for b in range(xy.shape[0]):
        _overlap(xy[b], mesh, prefix, work)
        intersection[b] = work.sums[1]
        area[b] = work.sums[2]


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def pose_overlap(vertices, linear, shift, intrinsics, near, mesh, prefix, intersection, area):
    """As overlap for one mesh at B placements."""
    work = _scratch(mesh, prefix.shape[0], prefix.shape[1] - 1)
    points = np.empty((vertices.shape[0], 2), np.float32)
    for b in range(linear.shape[0]):
        _place(vertices, linear[b], shift[b], intrinsics, near, points)
        _overlap(points, mesh, prefix, work)
        intersection[b] = work.sums[1]
        area[b] = work.sums[2]


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def render_images(xy, mesh, antialias, image):
    """Silhouettes (B, H, W) of B meshes, written over image."""
    height, width = image.shape[1:]
    work = _scratch(mesh, height, width)
    for b in range(xy.shape[0]):
        count, (row0, row1, col0, col1) = _outline(xy[b], mesh, height, width, work)
        _cover_rows(work.delta, work.covered, row0, row1, col0, col1, width)
        image[b] = 0
        for r in range(row0, row1):
            for c in range(col0, col1):
                image[b, r, c] = work.covered[r, c]
        if not antialias:
            continue
        found = _separated_pairs(xy[b], mesh, count, height, width, work)
        for k in range(found):
            r, c, amount = _blend(work.pairs[k], work.position, width)
            image[b, r, c] += amount
        for k in range(found):
            r, c, _ = _blend(work.pairs[k], work.position, width)
            image[b, r, c] = _unit(image[b, r, c])
        _forget_pairs(found, width, work)


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def image_gradient(xy, mesh, image_grad, grad):
    """Pull d(loss)/d(image) (B, H, W) back to the vertices; grad (B, V, 2) starts at zero."""
    height, width = image_grad.shape[1:]
    work = _scratch(mesh, height, width)
    for b in range(xy.shape[0]):
        count, (row0, row1, col0, col1) = _outline(xy[b], mesh, height, width, work)
        _cover_rows(work.delta, work.covered, row0, row1, col0, col1, width)
        found = _separated_pairs(xy[b], mesh, count, height, width, work)
        for k in range(found):
            pair = work.pairs[k]
            r, c, _ = _blend(pair, work.position, width)
            pull = image_grad[b, r, c] if pair & 1 == 1 else -image_grad[b, r, c]
            _push_edge(xy[b], mesh.edges, pair, work.owner, width, pull, grad[b])
        _forget_pairs(found, width, work)


@nb.njit
def _clip_near(corners, near, polygon):
    """Part of a triangle (3, 3) in front of the plane z = near, as a polygon; its corner count."""
    count = 0
    for i in range(3):
        j = (i + 1) % 3
        zi, zj = corners[i, 2], corners[j, 2]
        if zi >= near:
            polygon[count] = corners[i]
            count += 1
        if (zi >= near) != (zj >= near):
            t = (near - zi) / (zj - zi)
            for d in range(3):
                polygon[count, d] = corners[i, d] + t * (corners[j, d] - corners[i, d])
            polygon[count, 2] = near
            count += 1
    return count


@nb.njit
def _draw_depth(a, b, c, depth):
    """Draw one projected triangle; corners are (column, row, 1 / z)."""
    height, width = depth.shape
    area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    if not (abs(area) > 1e-12):
        return
    left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
    top, bottom = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
    if right < 0 or bottom < 0 or left > width or top > height:
        return
    col0, col1 = math.ceil(max(left, 0.0) - 0.5), math.ceil(min(right, width) - 0.5)
    row0, row1 = math.ceil(max(top, 0.0) - 0.5), math.ceil(min(bottom, height) - 0.5)
    for r in range(row0, row1):
        y = r + 0.5
        for col in range(col0, col1):
            x = col + 0.5
            wb = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
            wc = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
            wa = 1.0 - wb - wc
            if wa < 0.0 or wb < 0.0 or wc < 0.0:
                continue
            z = np.float32(1.0 / (wa * a[2] + wb * b[2] + wc * c[2]))
            if z < depth[r, col]:
                depth[r, col] = z


@nb.njit(cache=True, nogil=True)
def z_buffer(vertices, faces, intrinsics, near, depth):
    """Nearest z per pixel centre, over what depth (H, W) already holds."""
    corners = np.empty((3, 3), np.float64)
    polygon = np.empty((4, 3), np.float64)
    for f in range(faces.shape[0]):
        finite = True
        for i in range(3):
            for d in range(3):
                corners[i, d] = vertices[faces[f, i], d]
                finite = finite and math.isfinite(corners[i, d])
        if not finite:
            continue
        count = _clip_near(corners, near, polygon)
        for i in range(count):
            x, y, z = polygon[i, 0], polygon[i, 1], polygon[i, 2]
            polygon[i, 0] = (intrinsics[0, 0] * x + intrinsics[0, 1] * y) / z + intrinsics[0, 2]
            polygon[i, 1] = intrinsics[1, 1] * y / z + intrinsics[1, 2]
            polygon[i, 2] = 1.0 / z
        for i in range(2, count):
            _draw_depth(polygon[0], polygon[i - 1], polygon[i], depth)
