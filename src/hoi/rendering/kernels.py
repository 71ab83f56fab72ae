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

import numba as nb
import numpy as np

HALF = np.float32(0.5)
ONE = np.float32(1.0)
# Faces that reach further than this many pixels from the image corner are left out: beyond it
# float32 no longer places a crossing within a tenth of a pixel.
FARTHEST_PIXEL = np.float32(1e6)

# Plain fast maths would let the compiler assume that no NaN exists, and with it drop the checks
# that keep NaN out; only re-association and contraction are allowed.
_SAFE_MATH = {"reassoc", "contract", "arcp", "nsz"}


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


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def loss_and_gradient(
    xy, faces, edges, edge_faces, mask, keep, edge_distance, prefix, base_loss,
    mask_weight, edge_weight, loss, intersection, area, grad,
):  # fmt: skip
    """Fused loss, soft overlap and gradient of B meshes against one target; grad starts at zero."""
    height, width = mask.shape
    covered = np.zeros((height, width), np.uint8)
    delta = np.zeros((height, width + 1), np.int16)
    sign = np.empty(faces.shape[0], np.int8)
    chosen = np.empty(edges.shape[0] + 1, np.int32)
    multiplicity = np.empty(edges.shape[0] + 1, np.int16)
    position = np.empty((2, height, width), np.float32)
    owner = np.full((2, height, width), -1, np.int32)
    pairs = np.empty(2 * height * width, np.int32)
    change = np.zeros((height, width), np.float32)
    sums = np.zeros(3, np.float64)
    for b in range(xy.shape[0]):
        points = xy[b]
        _orient_faces(points, faces, sign)
        count = _outline_edges(edges, edge_faces, sign, chosen, multiplicity)
        row0, row1, col0, col1 = _pixel_window(points, edges, chosen, count, height, width)
        _mark_crossings(points, edges, chosen, multiplicity, count, height, width, delta)
        _sum_runs(delta, covered, prefix, row0, row1, col0, col1, width, sums)
        found = _boundary_pairs(
            points, edges, chosen, count, covered, height, width, position, owner, pairs
        )
        total = mask_weight * (base_loss + sums[0])
        shared, own = sums[1], sums[2]
        for k in range(found):
            r, c, amount = _blend(pairs[k], position, width)
            hard = np.float32(covered[r, c])
            old = _unit(hard + change[r, c])
            change[r, c] += amount
            new = _unit(hard + change[r, c])
            weight, wanted = keep[r, c], mask[r, c]
            total += mask_weight * weight * (new - old) * (new + old - 2 * wanted)
            shared += weight * wanted * (new - old)
            own += weight * (new - old)
        for k in range(found):
            pair = pairs[k]
            r, c, _ = _blend(pair, position, width)
            blended = _unit(np.float32(covered[r, c]) + change[r, c])
            direction = np.float32(2 * (pair & 1) - 1)
            pull = 2 * mask_weight * keep[r, c] * (blended - mask[r, c]) * direction

            axis = (pair >> 1) & 1
            r0 = (pair >> 2) // width
            c0 = (pair >> 2) - r0 * width
            r1, c1 = (r0, c0 + 1) if axis == 0 else (r0 + 1, c0)
            slack = edge_distance[r1, c1] - edge_distance[r0, c0]
            weight = edge_weight * min(keep[r0, c0], keep[r1, c1])
            fraction = position[axis, r0, c0] - np.float32(c0 if axis == 0 else r0) - HALF
            total += weight * (edge_distance[r0, c0] + fraction * slack)
            _push_edge(points, edges, pair, owner, width, pull + weight * slack, grad[b])
        for k in range(found):
            pair = pairs[k]
            r, c, _ = _blend(pair, position, width)
            change[r, c] = 0
        for k in range(found):
            pixel = pairs[k] >> 2
            owner[(pairs[k] >> 1) & 1, pixel // width, pixel % width] = -1
        loss[b] = total
        intersection[b] = shared
        area[b] = own


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def overlap(xy, faces, edges, edge_faces, prefix, intersection, area):
    """Weighted intersection with the target and own area of B silhouettes, hard coverage."""
    height, width = prefix.shape[0], prefix.shape[1] - 1
    covered = np.zeros((height, width), np.uint8)
    delta = np.zeros((height, width + 1), np.int16)
    sign = np.empty(faces.shape[0], np.int8)
    chosen = np.empty(edges.shape[0] + 1, np.int32)
    multiplicity = np.empty(edges.shape[0] + 1, np.int16)
    sums = np.zeros(3, np.float64)
    for b in range(xy.shape[0]):
        points = xy[b]
        _orient_faces(points, faces, sign)
        count = _outline_edges(edges, edge_faces, sign, chosen, multiplicity)
        row0, row1, col0, col1 = _pixel_window(points, edges, chosen, count, height, width)
        _mark_crossings(points, edges, chosen, multiplicity, count, height, width, delta)
        _sum_runs(delta, covered, prefix, row0, row1, col0, col1, width, sums)
        intersection[b] = sums[1]
        area[b] = sums[2]


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def render_images(xy, faces, edges, edge_faces, antialias, image):
    """Silhouettes (B, H, W) of B meshes, written over image."""
    height, width = image.shape[1:]
    covered = np.zeros((height, width), np.uint8)
    delta = np.zeros((height, width + 1), np.int16)
    sign = np.empty(faces.shape[0], np.int8)
    chosen = np.empty(edges.shape[0] + 1, np.int32)
    multiplicity = np.empty(edges.shape[0] + 1, np.int16)
    position = np.empty((2, height, width), np.float32)
    owner = np.full((2, height, width), -1, np.int32)
    pairs = np.empty(2 * height * width, np.int32)
    for b in range(xy.shape[0]):
        points = xy[b]
        _orient_faces(points, faces, sign)
        count = _outline_edges(edges, edge_faces, sign, chosen, multiplicity)
        row0, row1, col0, col1 = _pixel_window(points, edges, chosen, count, height, width)
        _mark_crossings(points, edges, chosen, multiplicity, count, height, width, delta)
        _cover_rows(delta, covered, row0, row1, col0, col1, width)
        image[b] = 0
        for r in range(row0, row1):
            for c in range(col0, col1):
                image[b, r, c] = covered[r, c]
        if not antialias:
            continue
        found = _boundary_pairs(
            points, edges, chosen, count, covered, height, width, position, owner, pairs
        )
        for k in range(found):
            r, c, amount = _blend(pairs[k], position, width)
            image[b, r, c] += amount
        for k in range(found):
            r, c, _ = _blend(pairs[k], position, width)
            image[b, r, c] = _unit(image[b, r, c])
            pixel = pairs[k] >> 2
            owner[(pairs[k] >> 1) & 1, pixel // width, pixel % width] = -1


@nb.njit(cache=True, nogil=True, fastmath=_SAFE_MATH)
def image_gradient(xy, faces, edges, edge_faces, image_grad, grad):
    """Pull d(loss)/d(image) (B, H, W) back to the vertices; grad (B, V, 2) starts at zero."""
    height, width = image_grad.shape[1:]
    covered = np.zeros((height, width), np.uint8)
    delta = np.zeros((height, width + 1), np.int16)
    sign = np.empty(faces.shape[0], np.int8)
    chosen = np.empty(edges.shape[0] + 1, np.int32)
    multiplicity = np.empty(edges.shape[0] + 1, np.int16)
    position = np.empty((2, height, width), np.float32)
    owner = np.full((2, height, width), -1, np.int32)
    pairs = np.empty(2 * height * width, np.int32)
    for b in range(xy.shape[0]):
        points = xy[b]
        _orient_faces(points, faces, sign)
        count = _outline_edges(edges, edge_faces, sign, chosen, multiplicity)
        row0, row1, col0, col1 = _pixel_window(points, edges, chosen, count, height, width)
        _mark_crossings(points, edges, chosen, multiplicity, count, height, width, delta)
        _cover_rows(delta, covered, row0, row1, col0, col1, width)
        found = _boundary_pairs(
            points, edges, chosen, count, covered, height, width, position, owner, pairs
        )
        for k in range(found):
            pair = pairs[k]
            r, c, _ = _blend(pair, position, width)
            pull = image_grad[b, r, c] * np.float32(2 * (pair & 1) - 1)
            _push_edge(points, edges, pair, owner, width, pull, grad[b])
        for k in range(found):
            pixel = pairs[k] >> 2
            owner[(pairs[k] >> 1) & 1, pixel // width, pixel % width] = -1


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
