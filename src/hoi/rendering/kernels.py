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

    pixels: np.ndarray  # (H, W, 3) mask, keep, edge distance: what a pair asks for lies together
    prefix: np.ndarray
    base_loss: np.float32


class Weights(NamedTuple):
    """Of the two parts of the loss."""

    mask: np.float32
    edge: np.float32


class Scratch(NamedTuple):
    """Working memory of one call; between meshes `delta` and `change` are 0, `slot` is -1."""

    covered: np.ndarray  # (H, W) whether the pixel centre is covered
    delta: np.ndarray  # (H, 4 N > W) change of the winding number; wraps around harmlessly
    sign: np.ndarray  # (F,) way each face turns on screen
    chosen: np.ndarray  # (E + 1,) outline edges
    multiplicity: np.ndarray  # (E + 1,) of each chosen edge
    slot: np.ndarray  # (2, H, W) place of a separated pixel pair in the lists below
    pairs: np.ndarray  # (2 H W, 4) row and column of its first pixel, code, edge between them
    position: np.ndarray  # (2 H W,) where that edge passes, in pixels along the pair
    change: np.ndarray  # (H, W) blended coverage minus hard coverage
    sums: np.ndarray  # (3,) prefix table summed over the silhouette


@nb.njit
def _scratch(mesh, height, width):
    return Scratch(
        np.zeros((height, width), np.uint8),
        np.zeros((height, (width // 4 + 1) * 4), np.int16),
        np.empty(mesh.faces.shape[0], np.int8),
        np.empty(mesh.edges.shape[0] + 1, np.int32),
        np.empty(mesh.edges.shape[0] + 1, np.int16),
        np.full((2, height, width), -1, np.int32),
        np.empty((2 * height * width, 4), np.int32),
        np.empty(2 * height * width, np.float32),
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
def _fill(row, start, end, value):
    for c in range(start, end):
        row[c] = value


@nb.njit(fastmath=_SAFE_MATH)
def _sum_runs(delta, covered, prefix, row0, row1, col0, col1, sums):
    """Coverage at pixel centres inside the window, by runs; leaves delta zero again.

    `sums` becomes the target's prefix table summed over the covered pixels. Most of delta is zero
    and is passed over four columns at a time.
    """
    words = delta.view(np.int64)
    s0, s1, s2 = 0.0, 0.0, 0.0
    for r in range(row0, row1):
        winding = 0
        inside = 0
        start = col0
        for word in range(words.shape[1]):
            if words[r, word] == 0:
                continue
            for c in range(4 * word, 4 * word + 4):
                winding += delta[r, c]
                now = 1 if winding > 0 else 0
                if now == inside:
                    continue
                _fill(covered[r], start, min(c, col1), inside)
                start = c
                direction = 1 - 2 * now
                s0 += direction * prefix[r, c, 0]
                s1 += direction * prefix[r, c, 1]
                s2 += direction * prefix[r, c, 2]
                inside = now
            words[r, word] = 0
        _fill(covered[r], start, col1, 0)
    sums[0] = s0
    sums[1] = s1
    sums[2] = s2


@nb.njit(fastmath=_SAFE_MATH)
def _boundary_pairs(xy, edges, chosen, count, covered, height, width, slot, pairs, position):
    """Neighbouring pixels of unlike coverage, with the outermost edge between their centres.

    Steep edges look at pixels side by side (axis 0), flat edges at pixels above each other (axis
    1). A pair's code is ``2 * axis + coverage of its first pixel``.
    """
    found = 0
    for i in range(count):
        e = chosen[i]
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
                k = slot[0, r, c]
                if k < 0:
                    slot[0, r, c] = found
                    pairs[found, 0], pairs[found, 1] = r, c
                    pairs[found, 2], pairs[found, 3] = inside, e
                    position[found] = x
                    found += 1
                elif (inside == 1) == (x > position[k]):
                    pairs[k, 3] = e
                    position[k] = x
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
                k = slot[1, r, c]
                if k < 0:
                    slot[1, r, c] = found
                    pairs[found, 0], pairs[found, 1] = r, c
                    pairs[found, 2], pairs[found, 3] = 2 + inside, e
                    position[found] = y
                    found += 1
                elif (inside == 1) == (y > position[k]):
                    pairs[k, 3] = e
                    position[k] = y
    return found


@nb.njit(fastmath=_SAFE_MATH)
def _blend(pair, position):
    """The pixel that an edge blends and by how much: row, column, change of coverage."""
    r, c, code = pair[0], pair[1], pair[2]
    past_border = position - np.float32((r if code >= 2 else c) + 1)
    change = past_border if code & 1 == 1 else -past_border
    if past_border > 0:
        if code < 2:
            c += 1
        else:
            r += 1
    return r, c, change


@nb.njit(fastmath=_SAFE_MATH)
def _push_edge(xy, edges, pair, pull, grad):
    """Add d(position)/d(end points) * pull of the edge between a pair to grad (V, 2)."""
    r, c, code, e = pair[0], pair[1], pair[2], pair[3]
    a, b = edges[e, 0], edges[e, 1]
    dx, dy = xy[b, 0] - xy[a, 0], xy[b, 1] - xy[a, 1]
    if code < 2:
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
        points, mesh.edges, work.chosen, count, work.covered, height, width, work.slot, work.pairs,
        work.position,
    )  # fmt: skip


@nb.njit(fastmath=_SAFE_MATH)
def _forget_pairs(found, work):
    for k in range(found):
        work.slot[work.pairs[k, 2] >> 1, work.pairs[k, 0], work.pairs[k, 1]] = -1


@nb.njit(fastmath=_SAFE_MATH)
def _overlap(points, mesh, prefix, work):
    """Leaves the prefix table's sums over one hard silhouette in work.sums."""
    height, width = prefix.shape[0], prefix.shape[1] - 1
    _, (row0, row1, col0, col1) = _outline(points, mesh, height, width, work)
    _sum_runs(work.delta, work.covered, prefix, row0, row1, col0, col1, work.sums)


@nb.njit(fastmath=_SAFE_MATH)
def _compare(points, mesh, target, weights, work, grad):
    """Loss, soft intersection and soft area of one mesh; adds d(loss)/d(points) to grad (V, 2)."""
    height, width = target.pixels.shape[:2]
    pixels = target.pixels
    covered, change, pairs, position = work.covered, work.change, work.pairs, work.position
    count, (row0, row1, col0, col1) = _outline(points, mesh, height, width, work)
    _sum_runs(work.delta, covered, target.prefix, row0, row1, col0, col1, work.sums)
    found = _separated_pairs(points, mesh, count, height, width, work)

    mask_loss = target.base_loss + work.sums[0]
    shared, own = work.sums[1], work.sums[2]
    for k in range(found):
        r, c, amount = _blend(pairs[k], position[k])
        hard = np.float32(covered[r, c])
        old = _unit(hard + change[r, c])
        change[r, c] += amount
        new = _unit(hard + change[r, c])
        wanted, keep = pixels[r, c, 0], pixels[r, c, 1]
        mask_loss += keep * (new - old) * (new + old - TWO * wanted)
        shared += keep * (min(new, wanted) - min(old, wanted))
        own += keep * (new - old)

    edge_loss = 0.0
    for k in range(found):
        r, c, _ = _blend(pairs[k], position[k])
        r0, c0, code = pairs[k, 0], pairs[k, 1], pairs[k, 2]
        r1, c1, along = (r0, c0 + 1, c0) if code < 2 else (r0 + 1, c0, r0)
        blended = _unit(np.float32(covered[r, c]) + change[r, c])
        direction = ONE if code & 1 == 1 else -ONE
        pull = TWO * pixels[r, c, 1] * (blended - pixels[r, c, 0]) * direction

        distance = pixels[r0, c0, 2]
        slack = pixels[r1, c1, 2] - distance
        keep = min(pixels[r0, c0, 1], pixels[r1, c1, 1])
        fraction = position[k] - np.float32(along) - HALF
        edge_loss += keep * (distance + fraction * slack)
        total_pull = weights.mask * pull + weights.edge * keep * slack
        _push_edge(points, mesh.edges, pairs[k], total_pull, grad)
    for k in range(found):
        r, c, _ = _blend(pairs[k], position[k])
        change[r, c] = 0
    _forget_pairs(found, work)
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
    height, width = target.pixels.shape[:2]
    work = _scratch(mesh, height, width)
    for b in range(xy.shape[0]):
        loss[b], intersection[b], area[b] = _compare(xy[b], mesh, target, weights, work, grad[b])


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def pose_loss_and_gradient(
    vertices, linear, shift, intrinsics, near, mesh, target, weights,
    loss, intersection, area, linear_grad, shift_grad,
):  # fmt: skip
    """As loss_and_gradient for one mesh at B placements, gradient to the placements."""
    height, width = target.pixels.shape[:2]
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
    no_target = np.zeros((height, width + 1, 3), np.float32)
    for b in range(xy.shape[0]):
        count, (row0, row1, col0, col1) = _outline(xy[b], mesh, height, width, work)
        _sum_runs(work.delta, work.covered, no_target, row0, row1, col0, col1, work.sums)
        image[b] = 0
        for r in range(row0, row1):
            for c in range(col0, col1):
                image[b, r, c] = work.covered[r, c]
        if not antialias:
            continue
        found = _separated_pairs(xy[b], mesh, count, height, width, work)
        for k in range(found):
            r, c, amount = _blend(work.pairs[k], work.position[k])
            image[b, r, c] += amount
        for k in range(found):
            r, c, _ = _blend(work.pairs[k], work.position[k])
            image[b, r, c] = _unit(image[b, r, c])
        _forget_pairs(found, work)


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def image_gradient(xy, mesh, image_grad, grad):
    """Pull d(loss)/d(image) (B, H, W) back to the vertices; grad (B, V, 2) starts at zero."""
    height, width = image_grad.shape[1:]
    work = _scratch(mesh, height, width)
    no_target = np.zeros((height, width + 1, 3), np.float32)
    for b in range(xy.shape[0]):
        count, (row0, row1, col0, col1) = _outline(xy[b], mesh, height, width, work)
        _sum_runs(work.delta, work.covered, no_target, row0, row1, col0, col1, work.sums)
        found = _separated_pairs(xy[b], mesh, count, height, width, work)
        for k in range(found):
            pair = work.pairs[k]
            r, c, _ = _blend(pair, work.position[k])
            pull = image_grad[b, r, c] if pair[2] & 1 == 1 else -image_grad[b, r, c]
            _push_edge(xy[b], mesh.edges, pair, pull, grad[b])
        _forget_pairs(found, work)


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
