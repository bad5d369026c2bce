"""The depth camera's loops over pixels, compiled. `sensors` calls them and says what they are for.

Single precision throughout, and no reordering: the same images give the same bytes on every
processor.
"""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def measure(
    out,
    valid,
    d,
    far,
    step,
    noise,
    fate,
    loss,
    shadow,
    u,
    v,
    ray2,
    fB,
    fx,
    fy,
    jump,
    edge_hole,
    flying,
    sigma,
    slope_gain,
    quantum,
    min_range,
    ramp,
    grazing_loss,
    grazing,
    max_range,
    grazing_limit,
    unit,
):
    """`measure_depth` pixel by pixel. All images (H, W), all numbers float32."""
    one = np.float32(1)
    for y in range(d.shape[0]):
        row2 = (v[y] / fy) * (v[y] / fy)
        for x in range(d.shape[1]):
            if not valid[y, x] or shadow[y, x]:
                continue
            gx, gy = _gradient(d, y, x, 0, 1), _gradient(d, y, x, 1, 0)
            slope = min(abs(gx) + abs(gy), one)
            # Cosine of the angle between ray and surface normal. On a plane the disparity is
            # affine in the pixel, d ~ n.r with the ray r = ((u-cx)/fx, (v-cy)/fy, 1), so the
            # gradient gives n without points or cross products.
            nz = d[y, x] - gx * u[x] - gy * v[y]
            normal2 = (gx * fx) * (gx * fx) + (gy * fy) * (gy * fy) + nz * nz
            incidence = d[y, x] / np.sqrt(max(normal2 * (ray2[x] + row2 + one), np.float32(1e-12)))
            if incidence < grazing_limit:
                continue
            measured = d[y, x]
            # a plane changes by up to 4 slopes over the window
            if step[y, x] > jump + np.float32(6) * slope:
                mix = (fate[y, x] - edge_hole) / flying
                if mix < 0:
                    continue
                if mix < 1:
                    measured = far[y, x] + mix * step[y, x]
            measured += sigma * noise[y, x] * (one + slope_gain * slope)
            measured = np.rint(measured / quantum) * quantum
            # no disparity is far beyond the greatest range
            z = fB / max(measured, np.float32(1e-6))
            # the draws are below 1, so nothing is left at or below the minimum range
            lost = one - (z - min_range) / ramp
            if incidence < grazing:
                lost = max(lost, grazing_loss)
            if loss[y, x] < max(lost, np.float32(0)) or z > max_range:
                continue
            counts = np.rint(z / unit)
            if counts <= 65535:
                out[y, x] = counts


@njit(cache=True, error_model="numpy")
def _gradient(d, y, x, dy, dx):
    """Change per px along an axis.

    It is the smaller of forward and backward difference, so that edges do not count as slopes.
    """
    at_start = y - dy < 0 or x - dx < 0
    at_end = y + dy >= d.shape[0] or x + dx >= d.shape[1]
    if at_start and at_end:
        return np.float32(0)
    if at_start:
        return d[y + dy, x + dx] - d[y, x]
    backward = d[y, x] - d[y - dy, x - dx]
    if at_end:
        return backward
    forward = d[y + dy, x + dx] - d[y, x]
    return backward if abs(backward) < abs(forward) else forward


@njit(cache=True, error_model="numpy")
def shadow(d):
    """Pixels (H, W) that the second imager does not see.

    They lie outside its image, or behind something nearer in its column. It sees a pixel of column
    x at x - d, so a near object hides what lies beside its left edge.
    """
    height, width = d.shape
    hidden = np.zeros((height, width), np.bool_)
    column = np.empty(width, np.intp)
    seen, wide, closed = (
        np.empty(width + 1, np.float32),
        np.empty(width + 1, np.float32),
        np.empty(width + 1, np.float32),
    )
    for y in range(height):
        seen[:] = 0
        for x in range(width):
            # one column more on the left of the second image takes what falls outside
            column[x] = max(np.rint(np.float32(x) - d[y, x]), np.float32(-1)) + 1
            seen[column[x]] = max(seen[column[x]], d[y, x])
        # a surface that the second imager sees larger leaves single columns empty; the background
        # must not show through them
        for x in range(width + 1):
            wide[x] = max(seen[max(x - 1, 0)], seen[x], seen[min(x + 1, width)])
        for x in range(width + 1):
            closed[x] = min(wide[max(x - 1, 0)], wide[x], wide[min(x + 1, width)])
        for x in range(width):
            hidden[y, x] = column[x] == 0 or closed[column[x]] > d[y, x] + np.float32(1)
    return hidden


@njit(cache=True, error_model="numpy")
def draw_rectangles(out, depth, x, y, half, to, T, unit):
    """Draw each depth pixel into the colour image `out` (H, W); the lowest count stays.

    All numbers are float32.
    """
    height, width = out.shape
    margin, least, zero = np.float32(0.25), np.float32(1e-6), np.float32(0)
    corner = np.empty((2, 2), np.float32)
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            if depth[row, column] == 0:
                continue
            z = np.float32(depth[row, column]) * unit
            counts = np.rint(
                ((T[2, 0] * x[column] + T[2, 1] * y[row] + T[2, 2]) * z + T[2, 3]) / unit
            )
            if counts < 1 or counts >= 65535:
                continue
            for k in range(2):
                a = x[column] + (half[0] if k else -half[0])
                b = y[row] + (half[1] if k else -half[1])
                scale = np.float32(1) / max(
                    (T[2, 0] * a + T[2, 1] * b + T[2, 2]) * z + T[2, 3], least
                )
                for axis in range(2):
                    along = (T[axis, 0] * a + T[axis, 1] * b + T[axis, 2]) * z + T[axis, 3]
                    corner[k, axis] = along * scale * to[axis] + to[2 + axis]
            u0 = max(np.ceil(min(corner[0, 0], corner[1, 0]) - margin), zero)
            u1 = min(np.floor(max(corner[0, 0], corner[1, 0]) + margin), np.float32(width - 1))
            v0 = max(np.ceil(min(corner[0, 1], corner[1, 1]) - margin), zero)
            v1 = min(np.floor(max(corner[0, 1], corner[1, 1]) + margin), np.float32(height - 1))
            if u0 > u1 or v0 > v1:
                continue
            value = np.uint16(counts)
            for v in range(int(v0), int(v1) + 1):
                for u in range(int(u0), int(u1) + 1):
                    out[v, u] = min(out[v, u], value)
