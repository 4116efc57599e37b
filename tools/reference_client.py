#!/usr/bin/env python3
"""A client written from proto/terraquilt/v1 and docs/payload.md alone: follows a view, rebuilds the surface from what it holds, and
compares it with the heights that the server gives.

    pip install grpcio grpcio-tools numpy
    terraquilt serve DB &
    python3 tools/reference_client.py localhost:50051

Prints a line for each tolerance, with seams as delivered and corrected; exit 1 if a height is more than 1e-6 m off, or is there
on one side only; exit 2 if the server did not answer.
"""

import argparse
import functools
import math
import os
import pathlib
import struct
import sys
import tempfile

import grpc
import numpy as np

KAPPA = 1.1
SIDE = 33
WHOLE_MAX = 1 << 42


def stubs(folder):
    """Modules made from the proto files, by name."""
    from grpc_tools import protoc

    root = pathlib.Path(__file__).resolve().parent.parent / "proto"
    files = sorted(str(p) for p in root.glob("terraquilt/v1/*.proto"))
    if protoc.main(["protoc", f"-I{root}", f"--python_out={folder}", f"--grpc_python_out={folder}", *files]) != 0:
        sys.exit("the proto files could not be compiled")
    sys.path.insert(0, folder)
    import importlib

    return {
        f"{name}{kind}": importlib.import_module(f"terraquilt.v1.{name}_pb2{kind}")
        for name in ("terrain", "query", "view", "heights")
        for kind in ("", "_grpc")
    }


# ------------------------------------------------------------------------------------------ bytes


class Bits:
    """Bits of a byte string, the highest of a byte first."""

    def __init__(self, data):
        self.data, self.at, self.size = int.from_bytes(data, "big"), 0, 8 * len(data)

    def take(self, n):
        self.at += n
        if self.at > self.size:
            raise ValueError("packed bytes end too early")
        return (self.data >> (self.size - self.at)) & ((1 << n) - 1)

    def gamma(self):
        n = 0
        while self.take(1) == 0:
            n += 1
        return 1 << n | self.take(n)

    def rice(self, s):
        """A number whose size is expected from eight times those around."""
        parameter = (3 * s // 32 + 1).bit_length() - 1
        ones = 0
        while ones < 24 and self.take(1):
            ones += 1
        return ones << parameter | self.take(parameter) if ones < 24 else self.take(48)

    def end(self):
        left = self.size - self.at
        if left >= 8 or self.take(left) != 0:
            raise ValueError("packed bytes are left over")


def unzigzag(v):
    return v >> 1 if v & 1 == 0 else -(v >> 1) - 1


def zigzag(v):
    return 2 * v if v >= 0 else -2 * v - 1


def unpack_vertices(data):
    """33 x 33 heights, [b, a]."""
    flags = data[0]
    if flags == 128:
        return np.frombuffer(data, "<f8", SIDE * SIDE, 1).reshape(SIDE, SIDE)
    decimal, scaled, classes, flat = (flags >> k & 1 for k in range(4))
    exponent, at = struct.unpack_from("<b", data, 1)[0], 2
    scale, offset = 1.0, 0.0
    if scaled:
        scale, offset = struct.unpack_from("<dd", data, at)
        at += 16

    first, shift = 0, 0
    while True:
        byte = data[at]
        first |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            break
    first = unzigzag(first)
    count = SIDE * SIDE
    q, m, kind, rest = [0] * count, [0] * count, [0] * count, [0] * count
    if flat:
        q = [first] * count
    else:
        c = struct.unpack_from("<5b", data, at)
        bits = Bits(data[at + 5 :])
        width = 0
        if classes:
            k = 0
            while k < count:
                what, run = bits.take(2), bits.gamma()
                kind[k : k + run] = [what] * run
                k += run
            width = bits.take(6)
        for k in range(count):
            b, a = divmod(k, SIDE)
            if k == 0:
                p, s = first, 0
            elif b == 0 or a == 0:
                n = k - 1 if b == 0 else k - SIDE
                p, s = q[n], 8 * m[n]
            else:
                w, n = k - 1, k - SIDE
                nw, ne, ww, nn = n - 1, n + (a < 32), w - (a > 1), n - SIDE * (b > 1)
                up = q[n]
                p = up + (sum(ck * (q[x] - up) for ck, x in zip(c, (w, nw, ne, ww, nn))) + 32 >> 6)
                p = max(-WHOLE_MAX, min(WHOLE_MAX, p))
                s = 2 * (m[w] + m[n]) + m[nw] + m[ne] + m[ww] + m[nn]
            if kind[k] == 2:
                q[k], m[k] = p, s // 8
                continue
            m[k] = bits.rice(s)
            q[k] = p + unzigzag(m[k])
            if kind[k] == 1:
                rest[k] = unzigzag(bits.take(width))
        bits.end()
    q = np.array(q, float)
    sample = np.float32(q / 10.0**exponent).astype(float) if decimal else q * 2.0**exponent
    z = sample * scale + offset if scaled else sample
    z = z + np.array(rest, float) * 2.0**-21
    z[np.array(kind) == 2] = 0.0
    return z.reshape(SIDE, SIDE)


def unpack_cells(level, data):
    """Which cells of a block are in the mask, [j, i] from its corner."""
    n = 28 << level
    cells = np.zeros((n, n), bool)
    if not data:
        cells[:] = True
        return cells
    bits = Bits(data)

    def part(x, y, size):
        if bits.take(1) == 0:
            return
        if bits.take(1) == 0:
            cells[y : y + size, x : x + size] = True
        elif size == 7:
            for row in range(y, y + 7):
                for col in range(x, x + 7):
                    cells[row, col] = bits.take(1)
        else:
            half = size // 2
            for dx, dy in ((0, 0), (half, 0), (0, half), (half, half)):
                part(x + dx, y + dy, half)

    part(0, 0, n)
    bits.end()
    return cells


@functools.lru_cache(maxsize=4096)
class Correction:
    """The correction of a survey over a level-0 place. The same bytes are unpacked once."""

    STEP = 2.0**-16

    def __init__(self, data):
        self.bytes = len(data)
        self.smooth, count = struct.unpack_from("<BH", data)
        at, spans = 3, []
        for _ in range(count):
            ends = np.frombuffer(data, "<f4", 2 * data[at], at + 1).astype(float)
            spans.append(ends.reshape(-1, 2))
            at += 1 + 8 * len(spans[-1])
        self.side = 59 if self.smooth else 57
        bits = Bits(data[at:])
        self.channels = [(s, self.nodes(bits), self.flags(bits)) for s in spans]
        bits.end()

    def nodes(self, bits):
        side = self.side
        q, m = [0] * side * side, [0] * side * side
        for k in range(side * side):
            b, a = divmod(k, side)
            if k == 0:
                p, s = 0, 0
            elif b == 0 or a == 0:
                n = k - 1 if b == 0 else k - side
                p, s = q[n], 8 * m[n]
            else:
                w, n = k - 1, k - side
                nw, ne, ww, nn = n - 1, n + (a < side - 1), w - (a > 1), n - side * (b > 1)
                p = max(-WHOLE_MAX, min(WHOLE_MAX, q[w] + q[n] - q[nw]))
                s = 2 * (m[w] + m[n]) + m[nw] + m[ne] + m[ww] + m[nn]
            m[k] = bits.rice(s)
            q[k] = p + unzigzag(m[k])
        return np.array(q, float).reshape(side, side) * self.STEP

    def flags(self, bits):
        flags, now = [], bool(bits.take(1))
        while len(flags) < self.side**2:
            flags += [now] * bits.gamma()
            now = not now
        return np.array(flags).reshape(self.side, self.side)

    def at(self, x, y, z, ramp):
        """At positions in cells from the corner of the place, and tolerances."""
        a, b = (np.clip(np.floor(2 * c), 0, 55).astype(int) for c in (x, y))
        s, t = 2 * x - a, 2 * y - b
        total = np.zeros(len(x))
        for spans, n, _ in self.channels:
            if self.smooth:
                bs, bt = splines(s), splines(t)
                value = sum(bt[k] * sum(bs[m] * n[b + k, a + m] for m in range(4)) for k in range(4))
            else:
                left = n[b, a] + (n[b + 1, a] - n[b, a]) * t
                right = n[b, a + 1] + (n[b + 1, a + 1] - n[b, a + 1]) * t
                value = left + (right - left) * s
            shown = np.zeros(len(x))
            for bottom, top in spans:
                up = 1.0 if bottom == 0 else ramp((z - bottom) / ((KAPPA - 1) * bottom))
                down = 1.0 if math.isinf(top) else 1 - ramp((z - top) / ((KAPPA - 1) * top))
                shown = shown + up * down
            total += np.minimum(shown, 1.0) * value
        return total


def splines(t):
    """The four cubic B-splines over a step."""
    u = 1.0 - t
    return u**3 / 6, (t**2 * (3 * t - 6) + 4) / 6, (u**2 * (3 * u - 6) + 4) / 6, t**3 / 6


# ------------------------------------------------------------------------------------------ the surface


def second_derivatives(z):
    """Of natural cubic splines along the last axis."""
    n = z.shape[-1]
    system = np.diag(np.full(n - 2, 4.0)) + np.diag(np.ones(n - 3), 1) + np.diag(np.ones(n - 3), -1)
    right = 6.0 * (z[..., 2:] - 2.0 * z[..., 1:-1] + z[..., :-2])
    out = np.zeros_like(z)
    out[..., 1:-1] = np.linalg.solve(system, right[..., None])[..., 0] if right.ndim == 1 else right @ np.linalg.inv(system)
    return out


def between(x, p, q, m, n):
    u = 1.0 - x
    return p + (q - p) * x - x * u / 6.0 * ((1.0 + u) * m + (1.0 + x) * n)


class Shape:
    """The heights of a patch."""

    def __init__(self, z, bicubic):
        self.z, self.bicubic = z, bicubic
        if bicubic:
            self.zs = second_derivatives(z)
            self.zt = second_derivatives(z.T).T
            self.zst = second_derivatives(self.zs.T).T

    def at(self, s, t):
        a = np.clip(np.floor(s), 0, SIDE - 2).astype(int)
        b = np.clip(np.floor(t), 0, SIDE - 2).astype(int)
        x, y = s - a, t - b
        if not self.bicubic:
            z = self.z
            left = z[b, a] + (z[b + 1, a] - z[b, a]) * y
            right = z[b, a + 1] + (z[b + 1, a + 1] - z[b, a + 1]) * y
            return left + (right - left) * x
        along = lambda f, ft, c: between(y, f[b, c], f[b + 1, c], ft[b, c], ft[b + 1, c])
        return between(
            x,
            along(self.z, self.zt, a),
            along(self.z, self.zt, a + 1),
            along(self.zs, self.zst, a),
            along(self.zs, self.zst, a + 1),
        )


def metres_per_unit(ground, x, y):
    if ground.unit == "m":
        return np.ones(2)
    f = math.radians(y)
    east = 111412.84 * math.cos(f) - 93.5 * math.cos(3 * f) + 0.118 * math.cos(5 * f)
    return np.array([east, 111132.92 - 559.82 * math.cos(2 * f) + 1.175 * math.cos(4 * f)])


def tolerance_at(tolerance, ground, p):
    """Allowed error at points, metres."""
    kind = tolerance.WhichOneof("kind")
    if kind == "error_m":
        return np.full(len(p), min(tolerance.error_m, sys.float_info.max))
    if kind == "camera":
        c = tolerance.camera
        d = np.array([c.look_at_x - c.eye_x, c.look_at_y - c.eye_y, c.look_at_z - c.eye_z])
        flat, length = math.hypot(d[0], d[1]), math.sqrt(d @ d)
        forward = d[:2] / flat if flat > 0 else np.array([0.0, 1.0])
        sin, cos = -d[2] / length, flat / length
        focal = c.viewport_height / 2 / math.tan(math.radians(c.fov_deg) / 2)
        near = max((c.far_m or 100000.0) * 1e-5, 0.01)
        h = c.eye_z - (ground.z_max if sin > 0 else ground.z_min)
        dx, dy = p[:, 0] - c.eye_x, p[:, 1] - c.eye_y
        x, y = dx * forward[0] + dy * forward[1], dx * forward[1] - dy * forward[0]
        w = np.maximum(x * cos + h * sin, near)
        below = focal * np.hypot(x, sin * y) + c.pixels * abs(sin) * w
        with np.errstate(divide="ignore"):
            return c.pixels * w * w / below
    if kind == "foci":
        least = np.full(len(p), np.inf)
        for f in tolerance.foci.foci:
            d = (p - [f.x, f.y]) * metres_per_unit(ground, f.x, f.y)
            beyond = np.maximum(np.hypot(d[:, 0], d[:, 1]) - f.radius_m, 0.0)
            least = np.minimum(least, f.error_m + f.growth * beyond)
        return least
    r = tolerance.raster
    values = np.frombuffer(r.errors_m, "<f4").astype(float).reshape(r.rows, r.cols)
    steps = np.array([[r.col_dx, r.row_dx], [r.col_dy, r.row_dy]])
    i, j = np.linalg.solve(steps, (p - [r.x, r.y]).T)
    i, j = np.clip(i, 0, r.cols - 1), np.clip(j, 0, r.rows - 1)
    a, b = np.floor(i).astype(int), np.floor(j).astype(int)
    a1, b1 = np.minimum(a + 1, r.cols - 1), np.minimum(b + 1, r.rows - 1)
    s, t = i - a, j - b
    low = (1 - s) * values[b, a] + s * values[b, a1]
    return (1 - t) * low + t * ((1 - s) * values[b1, a] + s * values[b1, a1])


class Terrain:
    """What a client holds: patches, frames, masks and corrections."""

    def __init__(self):
        self.ground, self.surveys, self.patches, self.masks = None, {}, {}, {}
        self.corrections, self.shapes = {}, {}

    def index(self, survey, p):
        """Positions in the index space of a survey: post (i, j) is at (i, j)."""
        f = self.surveys[survey]
        size = 2.0**self.ground.lattice_unit_log2
        d = p - np.array([f.anchor_x, f.anchor_y], float) * size
        u, v = np.array([f.u_x, f.u_y], float) * size, np.array([f.v_x, f.v_y], float) * size
        det = u[0] * v[1] - u[1] * v[0]
        return (d[:, 0] * v[1] - d[:, 1] * v[0]) / det, (u[0] * d[:, 1] - u[1] * d[:, 0]) / det

    def masked(self, survey, i, j):
        """Which of the cells (i, j) are in the mask of a survey."""
        found = np.zeros(i.shape, bool)
        for (s, level, bi, bj), cells in self.masks.items():
            if s != survey:
                continue
            n = 28 << level
            x, y = i - bi * n, j - bj * n
            here = (x >= 0) & (x < n) & (y >= 0) & (y < n)
            found[here] = True if cells is None else cells[y[here], x[here]]
        return found

    def ramp(self, t):
        t = np.clip(t, 0.0, 1.0)
        return ((6.0 * t - 15.0) * t + 10.0) * t**3 if self.bicubic else t

    def outside(self, survey, p):
        """1 - v."""
        i, j = self.index(survey, p)
        ci, cj = np.floor(i).astype(int), np.floor(j).astype(int)
        x, y = i - ci, j - cj
        product = np.ones(len(p))
        for dj in (-1, 0, 1):
            for di in (-1, 0, 1):
                ax = {-1: self.ramp(x), 0: 0.0, 1: self.ramp(1.0 - x)}[di]
                ay = {-1: self.ramp(y), 0: 0.0, 1: self.ramp(1.0 - y)}[dj]
                product = np.where(self.masked(survey, ci + di, cj + dj), product * (ax + (1.0 - ax) * ay), product)
        return product

    def correction(self, survey, p, z):
        """What is added to the patches of a survey."""
        i, j = self.index(survey, p)
        place_i, place_j = np.floor(i / 28).astype(int), np.floor(j / 28).astype(int)
        out = np.zeros(len(p))
        for key in set(zip(place_i.tolist(), place_j.tolist())):
            block = self.corrections.get((survey, *key))
            if block is not None:
                here = np.flatnonzero((place_i == key[0]) & (place_j == key[1]))
                x, y = i[here] - 28 * key[0], j[here] - 28 * key[1]
                out[here] = block.at(x, y, z[here], self.ramp)
        return out

    @property
    def bicubic(self):
        return self.ground.patch == 2

    def heights(self, p, tolerance):
        """Heights at points; NaN where there is no data."""
        z = tolerance_at(tolerance, self.ground, p)
        outside = {s: self.outside(s, p) for s in self.surveys}
        index = {s: self.index(s, p) for s in self.surveys}
        corrections = {s: self.correction(s, p, z) for s in {key[0] for key in self.corrections}}
        weights, total = np.zeros(len(p)), np.zeros(len(p))
        reference = np.full(len(p), np.nan)
        for patch in sorted(self.patches.values(), key=lambda q: q.id):
            f, r = self.surveys[patch.survey], float(1 << patch.level)
            a, b = ((c - r * (28 * k - 2)) / r for c, k in zip(index[patch.survey], (patch.i, patch.j)))
            t, s = np.abs(a / 16.0 - 1.0), np.abs(b / 16.0 - 1.0)
            here = np.flatnonzero((t < 1.0) & (s < 1.0) & (outside[patch.survey] < 1.0))
            if len(here) == 0:
                continue
            t, s, at = t[here], s[here], z[here]
            if self.bicubic:
                w = 25 / 16 * (1 - t) ** 3 * (3 * t + 1) * (1 - s) ** 3 * (3 * s + 1)
            else:
                w = (1 - t) * (1 - s)
            w = w / (16 * r * f.step_x * 16 * r * f.step_y)
            bot, top = float(patch.bot_m), float(patch.top_m)
            down = np.ones(len(here)) if math.isinf(top) else 1 - self.ramp((at - top) / ((KAPPA - 1) * top))
            up = np.ones(len(here)) if bot == 0 else self.ramp((at - bot) / ((KAPPA - 1) * bot))
            if patch.floor:
                m = np.ones(len(here))
                for n, other in self.surveys.items():
                    if other.accuracy_m < patch.bot_m:
                        m = m * outside[n][here]
                up = up + (1 - up) * m
            w = w * (1 - outside[patch.survey][here]) * up * down
            keep = w > 0
            here, w = here[keep], w[keep]
            if len(here) == 0:
                continue
            shape = self.shapes.get(patch.id)
            if shape is None:
                shape = self.shapes[patch.id] = Shape(unpack_vertices(patch.payload), self.bicubic)
            height = shape.at(a[here], b[here])
            if patch.survey in corrections:
                height = height + corrections[patch.survey][here]
            reference[here] = np.where(np.isnan(reference[here]), height, reference[here])
            weights[here] += w
            total[here] += w * (height - reference[here])
        with np.errstate(invalid="ignore", divide="ignore"):
            return reference + total / weights

    # What streams bring.

    def take_blocks(self, d):
        for m in d.masks_removed:
            self.masks.pop((m.survey, m.level, m.i, m.j), None)
        for c in d.corrections_removed:
            del self.corrections[c.survey, c.i, c.j]
        for c in d.corrections:
            self.corrections[c.survey, c.i, c.j] = Correction(c.nodes)
        for m in d.masks:
            self.masks[m.survey, m.level, m.i, m.j] = unpack_cells(m.level, m.cells) if m.cells else None

    def take_query(self, replies):
        """The answer of Query.Patches; its header and end."""
        header = end = None
        for reply in replies:
            kind = reply.WhichOneof("kind")
            if kind == "header":
                header = reply.header
                self.ground = header.ground
                self.surveys = {f.survey: f for f in header.surveys}
            elif kind == "part":
                self.take_blocks(reply.part)
                self.patches.update({p.id: p for p in reply.part.patches})
            else:
                end = reply.end
        if end is None or end.patches != len(self.patches):
            raise ValueError(f"{len(self.patches)} patches came of {end and end.patches}")
        return header, end


class View:
    """A view that is held: applies differences as they come. `terrain.patches` is by handle here."""

    def __init__(self, terrain):
        self.terrain, self.number, self.session = terrain, 0, b""

    def apply(self, d):
        """One message; true if the difference is complete."""
        t = self.terrain
        self.session = d.session or self.session
        if d.to != getattr(self, "pending", None):
            if d.__getattribute__("from") == 0:
                t.surveys, t.patches, t.masks, t.corrections = {}, {}, {}, {}
            elif d.__getattribute__("from") != self.number:
                raise ValueError("the difference does not fit")
            self.pending = d.to
        if d.HasField("ground"):
            t.ground = d.ground
        for h in d.removed:
            del t.patches[h]
        for s in d.surveys_removed:
            t.surveys.pop(s, None)
        t.surveys.update({f.survey: f for f in d.surveys})
        t.patches.update({p.handle: p for p in d.added})
        for c in d.changed:
            t.patches[c.handle].top_m, t.patches[c.handle].floor = c.top_m, c.floor
            if c.HasField("survey"):
                t.patches[c.handle].survey = c.survey
        t.take_blocks(d)
        if d.more:
            return False
        if d.patches != len(t.patches) or d.hash != set_hash(t.patches.values(), d.hash):
            raise ValueError(f"{len(t.patches)} patches are held, the server says {d.patches}; or the hash is another")
        self.number, self.pending = d.to, None
        return True


def set_hash(patches, otherwise):
    """First 16 bytes of BLAKE3 over the ids; `otherwise` where Python has no BLAKE3 (pip install blake3)."""
    try:
        import blake3
    except ImportError:
        return otherwise
    return blake3.blake3(b"".join(sorted(p.id for p in patches))).digest()[:16]


# ------------------------------------------------------------------------------------------ the comparison


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("server", help="host:port")
    parser.add_argument("--token", default=os.environ.get("TERRAQUILT_TOKEN"), help="bearer token [default: $TERRAQUILT_TOKEN]")
    parser.add_argument("--points", type=int, default=2000, help="random points for each tolerance")
    parser.add_argument("--box", help="xmin,ymin,xmax,ymax [default: all there is]")
    parser.add_argument("--seams", choices=["off", "all", "consistent"], help="of the surface [default: all three]")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()

    with tempfile.TemporaryDirectory() as folder:
        modules = stubs(folder)
        return run(args, modules)


def run(args, modules):
    terrain_pb, query_pb, view_pb, heights_pb = (modules[n] for n in ("terrain", "query", "view", "heights"))
    channel = grpc.insecure_channel(args.server)
    metadata = [("authorization", f"Bearer {args.token}")] if args.token else []
    queries = modules["query_grpc"].QueryStub(channel)
    views = modules["view_grpc"].ViewStub(channel)
    heights = modules["heights_grpc"].HeightsStub(channel)
    tolerance = lambda **kind: terrain_pb.Tolerance(**kind)

    # What there is: an answer without patches says it.
    ask = query_pb.PatchesRequest(tolerance=tolerance(error_m=1e9), descriptors_only=True)
    ground = next(iter(queries.Patches(ask, metadata=metadata))).header.ground
    if not ground.HasField("bounds"):
        sys.exit("the database is empty")
    b = ground.bounds
    box = [float(v) for v in args.box.split(",")] if args.box else [b.xmin, b.ymin, b.xmax, b.ymax]
    wide, high = box[2] - box[0], box[3] - box[1]
    middle = [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2]
    region = terrain_pb.Region(box=terrain_pb.Box(xmin=box[0], ymin=box[1], xmax=box[2], ymax=box[3]))
    metres = metres_per_unit(ground, *middle)
    span = wide * metres[0]

    def camera(k):
        """A flight from west to east, turning."""
        x, y = box[0] + wide * (0.1 + 0.15 * k), middle[1] + 0.1 * high * math.sin(k)
        angle = 0.5 * k
        return tolerance(
            camera=terrain_pb.Camera(
                eye_x=x, eye_y=y, eye_z=ground.z_max + 0.05 * span,
                look_at_x=x + 0.3 * span * math.cos(angle), look_at_y=y + 0.3 * span * math.sin(angle),
                look_at_z=ground.z_min, fov_deg=45, viewport_width=1280, viewport_height=720, pixels=2,
            )
        )

    random = np.random.default_rng(args.seed)
    wanted = [("error 0 m", tolerance(error_m=0)), ("error 3 m", tolerance(error_m=3)), ("error 20 m", tolerance(error_m=20))]
    if ground.unit == "m":
        wanted += [(f"camera {k}", camera(k)) for k in range(4)]
    focus = terrain_pb.Focus(x=middle[0], y=middle[1], radius_m=0.05 * span, error_m=1, growth=0.05)
    wanted.append(("focus", tolerance(foci=terrain_pb.Foci(foci=[focus]))))
    grid = random.uniform(0.5, 40.0, (7, 9)).astype("<f4")
    raster = terrain_pb.ErrorRaster(
        cols=9, rows=7, x=box[0], y=box[3], col_dx=wide / 8, row_dy=-high / 6, errors_m=grid.tobytes()
    )
    wanted.append(("raster", tolerance(raster=raster)))

    bad = 0
    print("way    seams      tolerance     version  patches  bytes/patch  blocks  bytes/block  points  without data  bent  largest difference, m")

    def compare(way, seams, name, terrain, tol, version):
        nonlocal bad
        points = np.column_stack([random.uniform(box[0], box[2], args.points), random.uniform(box[1], box[3], args.points)])
        if tol.HasField("camera"):
            points = in_sight(tol.camera, terrain.ground, points)
        theirs = np.full(len(points), np.nan)
        bent = 0
        header = heights_pb.HeightsHeader(tolerance=tol, at=version, seams=seams)
        request = heights_pb.PointsRequest(header=header, points=points.astype("<f8").tobytes())
        for reply in heights.Ask(request, metadata=metadata):
            theirs[reply.first : reply.first + reply.count] = np.frombuffer(reply.z, "<f8")
            bent += np.count_nonzero(np.nan_to_num(np.frombuffer(reply.correction_m, "<f8")))
            assert reply.version == version
        ours = terrain.heights(points, tol)
        both = ~np.isnan(ours) & ~np.isnan(theirs)
        alone = int((np.isnan(ours) != np.isnan(theirs)).sum())
        worst = float(np.abs(ours - theirs)[both].max(initial=0.0))
        payload = [len(p.payload) for p in terrain.patches.values()]
        mean = np.mean(payload) if payload else 0.0
        verdict = "" if worst <= 1e-6 and alone == 0 else f"  FAILED ({alone} on one side only)"
        bad += bool(verdict)
        none = int(np.isnan(theirs).sum())
        blocks = [c.bytes for c in terrain.corrections.values()]
        block = np.mean(blocks) if blocks else 0.0
        print(
            f"{way:6} {seams[6:].lower():10} {name:12} {version:8} {len(payload):8} {mean:12.0f} {len(blocks):7} {block:12.0f}"
            f" {len(points):7} {none:13} {bent:5}  {worst:.3g}{verdict}"
        )

    for seams in [args.seams] if args.seams else ["off", "all", "consistent"]:
        seams = f"SEAMS_{seams.upper()}"
        for name, tol in wanted:
            terrain = Terrain()
            request = query_pb.PatchesRequest(region=region, tolerance=tol, seams=seams)
            head, _ = terrain.take_query(queries.Patches(request, metadata=metadata))
            compare("query", seams, name, terrain, head.tolerance, head.ground.version)
        follow(seams, views, view_pb, region, wanted, metadata, compare)
    return 1 if bad else 0


def follow(seams, views, view_pb, region, wanted, metadata, compare):
    """One view steered through all tolerances; compares after each."""
    import queue

    questions = queue.Queue()
    first = view_pb.Question(number=1, region=region, tolerance=wanted[0][1])
    questions.put(view_pb.ViewRequest(open=view_pb.OpenView(question=first, seams=seams)))
    terrain = Terrain()
    view = View(terrain)
    stream = views.Hold(iter(questions.get, None), metadata=metadata)
    for number, (name, tol) in enumerate(wanted, 1):
        if number > 1:
            question = view_pb.Question(number=number, region=region, tolerance=tol)
            questions.put(view_pb.ViewRequest(steer=question))
        for d in stream:
            if view.apply(d) and d.answers == number:
                break
        compare("view", seams, name, terrain, tol, d.version)
    questions.put(None)


def in_sight(c, ground, points):
    """Those points whose ground is surely in the picture of a camera: the set was made for no others."""
    eye, look = np.array([c.eye_x, c.eye_y, c.eye_z]), np.array([c.look_at_x, c.look_at_y, c.look_at_z])
    d = (look - eye) / np.linalg.norm(look - eye)
    right = np.array([d[1], -d[0], 0.0]) / math.hypot(d[0], d[1])
    up = np.cross(right, d)
    tan = math.tan(math.radians(c.fov_deg) / 2)
    p = np.column_stack([points, np.full(len(points), (ground.z_min + ground.z_max) / 2)]) - eye
    depth, x, y = p @ d, p @ right, p @ up
    wide = tan * c.viewport_width / c.viewport_height
    far = c.far_m or 100000.0
    return points[(depth > 0) & (depth < far) & (np.abs(x) < wide * depth) & (np.abs(y) < tan * depth)]


if __name__ == "__main__":
    try:
        sys.exit(main())
    except grpc.RpcError as e:
        print(f"{e.code().name}: {e.details()}", file=sys.stderr)
        sys.exit(2)
