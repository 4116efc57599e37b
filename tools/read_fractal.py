#!/usr/bin/env python3
"""Reads a fractal tile of heights or of brightness, after docs/fractal-format.md and docs/gtb-format.md alone.

    python3 tools/read_fractal.py tile.ifs out.asc

Writes the samples at zoom 1 as an ESRI ASCII grid. Slow, plain, whole files only: it shows that the pages are enough. Nothing but
Python is needed.
"""

import math
import struct
import sys
from collections import defaultdict

MAGIC = bytes.fromhex("894946530D0A1A0A")
MASK, BOUND, TURNED = 1, 2, 4
FLAT, MAPPED, SPLIT = 1, 2, 3
BLOCK = 16384

LOGISTIC = [int(65536 / (1 + math.exp(-x / 256)) + 0.5) for x in range(-2048, 2048)]


def logits():
    out, x = [], 0
    for k in range(4096):
        while x < 4095 and LOGISTIC[x] < 16 * k + 8:
            x += 1
        out.append(x - 2048)
    return out


LOGIT = logits()


def within(v, low, high):
    return max(low, min(high, v))


def length(v):
    return abs(v).bit_length()


class Fields:
    """The head, field by field."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, form):
        values = struct.unpack_from("<" + form, self.data, self.at)
        self.at += struct.calcsize("<" + form)
        return values if len(values) > 1 else values[0]

    def varint(self):
        value = shift = 0
        while True:
            byte = self.take("B")
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    def text(self):
        n = self.varint()
        return self.take(f"{n}s").decode() if n else ""


class Tile:
    """The head, and the body without its checksums."""

    def __init__(self, data):
        f = Fields(data)
        if f.take("8s") != MAGIC or f.take("B") != 1:
            sys.exit("this is no fractal tile of version 1")
        end = f.take("H")
        self.kind, self.flags = f.take("BB")
        if self.kind > 1:
            sys.exit("only heights and brightness are read")
        self.cols, self.rows, _ = f.varint(), f.varint(), f.varint()
        self.bound = f.varint() if self.flags & BOUND else None
        f.take("B")
        self.least, self.greatest = f.take("ii")
        self.error_max, self.error_rms = f.take("dd")
        self.maps = f.varint()
        self.unit, self.base, self.given = 1.0, 0.0, 0.0
        self.x0, self.dx, self.y0, self.dy = 0.0, 1.0, 0.0, -1.0
        if self.kind == 0:
            self.unit, self.base, self.given, self.x0, self.dx, self.y0, self.dy = f.take("7d")
            if self.flags & TURNED:
                f.take("dd")
            self.crs, self.vertical = f.text(), f.text()
        self.source = f.text()
        _, self.max, self.min = f.take("BBB")
        self.jump = f.varint()
        self.isometries, self.near, bits = f.take("BBB")
        self.scale_bits, self.scale_max = bits, 2 ** (bits - 1) - 1
        self.step, self.origin = f.take("dd")
        left, self.body = f.varint(), b""
        if f.at != end - 4:
            sys.exit(f"the fields of the head end at {f.at}, it at {end - 4}")
        f.at = end
        while left > 0:
            n = min(left, BLOCK)
            self.body += f.take(f"{n}s")
            f.take("4s")
            left -= n
        side = 2**self.max
        self.padded = [-(-n // side) * side for n in (self.cols, self.rows)]

    def mean(self, number):
        return self.origin + self.step * number


class Coder:
    """The range coder, counts and their mixing."""

    def __init__(self, data):
        self.data, self.at, self.range = data, 8, 2**64 - 1
        self.code = int.from_bytes((data[:8] + bytes(8))[:8], "big")

    def bit(self, p):
        bound = (self.range >> 16) * p
        one = self.code < bound
        if one:
            self.range = bound
        else:
            self.code -= bound
            self.range -= bound
        if self.range < 2**32:
            four = (self.data[self.at : self.at + 4] + bytes(4))[:4]
            self.range <<= 32
            self.code = self.code << 32 | int.from_bytes(four, "big")
            self.at += 4
        return int(one)

    def alone(self, count):
        bit = self.bit(within(count.p >> 6, 4, 65532))
        count.learn(bit)
        return bit

    def mixed(self, counts, weights):
        found = [LOGIT[c.p >> 10] for c in counts]
        x = within(sum(a * b for a, b in zip(found, weights.of)) >> 16, -2047, 2047)
        q = LOGISTIC[x + 2048]
        bit = self.bit(within(q, 32, 65504))
        e, r = 65536 * bit - q, 2 + 896 // (64 + weights.seen)
        weights.seen = min(weights.seen + 1, 4096)
        for k, logit in enumerate(found):
            w = weights.of[k] + ((logit * (e >> 2) * r + 32768) >> 16)
            weights.of[k] = within(w, -(2**19), 2**19)
        for c in counts:
            c.learn(bit)
        return bit

    def uniform(self, n):
        low, high = 0, n
        while high - low > 1:
            middle = low + (high - low) // 2
            if self.bit((high - middle) * 65536 // (high - low)):
                low = middle
            else:
                high = middle
        return low


class Count:
    def __init__(self):
        self.p, self.n = 2**21, 0

    def learn(self, bit):
        to = (2**22 - 1) if bit else 0
        self.p += ((to - self.p) * (655360 // (10 * self.n + 16))) >> 16
        self.n = min(self.n + 1, 250)


class Weights:
    def __init__(self):
        self.of, self.seen = [81920 // 3] * 3, 0


class Choice:
    def __init__(self, bits):
        self.bits, self.counts = bits, defaultdict(Count)

    def read(self, coder):
        node = 1
        for _ in range(self.bits):
            node = 2 * node + coder.alone(self.counts[node])
        return node - 2**self.bits


class Numbers:
    def __init__(self):
        self.counts, self.weights = defaultdict(Count), defaultdict(Weights)

    def read(self, coder, *contexts):
        def decide(k):
            counts = [self.counts[i, context, k] for i, context in enumerate(contexts)]
            return coder.mixed(counts, self.weights[k])

        if not decide(0):
            return 0
        negative, n = decide(1), 1
        while n < 26 and decide(1 + n):
            n += 1
        value = 1
        for k in range(n - 1):
            ask = [25 + 3 * n, 26 + 3 * n + (value & 1)]
            value = 2 * value + (decide(ask[k]) if k < 2 else coder.bit(32768))
        return -value if negative else value


def read_mask(tile, coder):
    void = [[0] * tile.cols for _ in range(tile.rows)]
    around = [(-1, 0), (-2, 0), (-3, 0), (-2, 1), (-1, 1), (0, 1), (1, 1), (2, 1), (-1, 2), (0, 2)]
    counts = defaultdict(Count)
    for y in range(tile.rows if tile.flags & MASK else 0):
        for x in range(tile.cols):
            context = 0
            for east, north in around:
                inside = 0 <= x + east < tile.cols and y >= north
                context = 2 * context + (void[y - north][x + east] if inside else 0)
            void[y][x] = coder.alone(counts[context])
    return void


class Tree:
    """Leaves: (cell, side, number of the mean, level of s, isometry, place of the domain)."""

    def __init__(self, tile, coder):
        self.tile, self.coder, self.leaves, self.means = tile, coder, [], {}
        self.numbers, self.last = Numbers(), defaultdict(lambda: Choice(2))
        self.kinds, self.weights = defaultdict(Count), defaultdict(Weights)
        self.signs = defaultdict(Count)
        self.scales = defaultdict(lambda: Choice(tile.scale_bits - 1))
        side = 2**tile.max
        ranges = [(x, y) for y in range(tile.padded[1] // side) for x in range(tile.padded[0] // side)]
        for level in range(tile.max - tile.min + 1):
            side = 2 ** (tile.max - level)
            if level == 0:
                self.roots(ranges)
            else:
                self.children(ranges, level, side)
            if side == 1:
                self.leaves += [(p, 1, self.means[p], 0, 0, (0, 0)) for p in ranges]
                return
            ranges = self.what(ranges, level, side)

    def lie(self, means, p):
        own, slopes, activity = means[p], [], 0
        for axis in (0, 1):
            sides = [tuple(v + d * (a == axis) for a, v in enumerate(p)) for d in (-1, 1)]
            before, after = (means.get(q, own) for q in sides)
            slopes.append(after - before)
            activity += abs(after - before) + 2 * abs(after + before - 2 * own)
        return slopes, min(19, length(activity))

    def roots(self, ranges):
        for p in ranges:
            guess, met = 0, []
            for k in (1, 2, 3):
                q = (p[0] - (k & 1), p[1] - (k >> 1))
                if q in self.means:
                    met.append(self.means[q])
                    guess += -met[-1] if k == 3 else met[-1]
            spread = max(met) - min(met) if met else 0
            guess = within(guess, min(met), max(met)) if met else 0
            rest = self.numbers.read(self.coder, min(19, length(spread)), 0, 0)
            self.means[p] = within(guess + rest, -(2**25), 2**25)

    def children(self, ranges, level, side):
        coarse, before = self.means, 0
        w, h = (n // side for n in self.tile.padded)
        self.means = {(x, y): coarse[x // 2, y // 2] for y in range(h) for x in range(w)}
        for first in range(0, len(ranges), 4):
            family = ranges[first : first + 4]
            parent = (family[0][0] // 2, family[0][1] // 2)
            own, (slopes, activity) = coarse[parent], self.lie(coarse, parent)
            wrong, total = 0, 0
            for k, p in enumerate(family):
                if k < 3:
                    slope = sum(s if k >> a & 1 else -s for a, s in enumerate(slopes))
                    contexts = (
                        20 * min(level, 5) + activity,
                        8 * min(19, length(wrong)) + k,
                        4 * min(19, length(before)) + min(k, 3),
                    )
                    rest = self.numbers.read(self.coder, *contexts)
                    mean = ((8 * own + slope + 4) >> 3) + rest
                    wrong += abs(rest)
                else:
                    table = self.last[2 * min(19, length(wrong)) + (activity > 4)]
                    mean = 4 * own - 2 - total + table.read(self.coder)
                self.means[p] = within(mean, -(2**25), 2**25)
                total += self.means[p]
            before = wrong

    def what(self, ranges, level, side):
        """Reads what each range is. Returns the ranges of the next level."""
        t, coder, seen, following, split = self.tile, self.coder, {}, [], 0
        count = [(n - 2 * side) // t.jump + 1 if n >= 2 * side else 0 for n in t.padded]
        i, is_last = min(level, 5), level == t.max - t.min
        for number, p in enumerate(ranges):
            slopes, activity = self.lie(self.means, p)
            split = 0 if number % 4 == 0 else split
            around = 4 * seen.get((p[0] - 1, p[1]), 0) + seen.get((p[0], p[1] - 1), 0)
            steep = min(19, length(sum(map(abs, slopes))))
            contexts = (activity, around, 4 * steep + min(3, split))

            def decide(which):
                counts = [self.kinds[i, which, k, context] for k, context in enumerate(contexts)]
                return coder.mixed(counts, self.weights[i, which])

            if not is_last and decide(0):
                seen[p], split = SPLIT, split + 1
                following += [(2 * p[0] + (k & 1), 2 * p[1] + (k >> 1)) for k in range(4)]
                continue
            is_map = min(count) > 0 and decide(1)
            seen[p] = MAPPED if is_map else FLAT
            leaf = (p, side, self.means[p], 0, 0, (0, 0))
            if is_map:
                n = [min(t.near, c) for c in count]
                centre = [max(0, v * side + t.jump // 2 - side // 2) // t.jump for v in p]
                first = [min(max(0, centre[a] - t.near // 2), count[a] - n[a]) for a in (0, 1)]
                near = decide(2) if t.near > 0 else 0
                row = 2 * i + near
                negative = coder.alone(self.signs[row])
                scale = min(t.scale_max - 1, self.scales[row].read(coder)) + 1
                isometry = coder.uniform(t.isometries)
                domain = tuple(
                    first[a] + coder.uniform(n[a]) if near else coder.uniform(count[a]) for a in (0, 1)
                )
                leaf = (p, side, self.means[p], -scale if negative else scale, isometry, domain)
            self.leaves.append(leaf)
        return following


def read_residual(tile, coder, void):
    q = [[0] * tile.cols for _ in range(tile.rows)]
    numbers = Numbers()

    def sign(v):
        return (v > 0) - (v < 0) + 1

    for y in range(tile.rows if tile.flags & BOUND else 0):
        for x in range(tile.cols):

            def old(east, north):
                return q[y - north][x + east] if 0 <= x + east < tile.cols and y >= north else 0

            if not void[y][x]:
                w, n, nw, ne, ww, nn = old(-1, 0), old(0, 1), old(-1, 1), old(1, 1), old(-2, 0), old(0, 2)
                far = abs(ww) + abs(nn) + abs(nw) + abs(ne)
                contexts = (
                    min(23, length(2 * abs(w) + 2 * abs(n) + abs(nw) + abs(ne))),
                    27 * sign(w) + 9 * sign(n) + 3 * sign(nw) + sign(ne),
                    24 * min(23, length(w + n)) + min(23, length(far)),
                )
                q[y][x] = numbers.read(coder, *contexts)
    return q


def source(k, c, r, n):
    """The column and row that isometry k reads for column c, row r of a block of n."""
    m = n - 1
    rows = [r, c, m - r, m - c, c, m - r, m - c, r]
    cols = [c, m - r, m - c, r, r, c, m - r, m - c]
    return cols[k], rows[k]


def half(x):
    def pairs(a, b):
        return [((a[k] + a[k + 1]) + (b[k] + b[k + 1])) / 4 for k in range(0, len(a), 2)]

    return [pairs(x[k], x[k + 1]) for k in range(0, len(x), 2)]


def boxes(x):
    """The means of the boxes of 2 x 2 that begin at each sample."""

    def pairs(a, b):
        return [((a[k] + a[k + 1]) + (b[k] + b[k + 1])) / 4 for k in range(len(a) - 1)]

    return [pairs(x[k], x[k + 1]) for k in range(len(x) - 1)]


def apply(tile, leaves, x, h, by, apart=1):
    """One pass at zoom 1 / by; the means in h that a domain reads are so far apart. Returns the mean change."""
    change = 0.0
    for (col, row), side, mean, scale, isometry, domain in leaves:
        n = side // by
        if n == 0:
            # Four samples of their own, one at half the zoom: the last of them leaves their mean.
            x[row // by][col // by] += tile.mean(mean) / 4
            continue
        if scale == 0:
            for y in range(row * n, (row + 1) * n):
                x[y][col * n : (col + 1) * n] = [tile.mean(mean)] * n
            continue
        left, top = (d * (tile.jump // 2) * apart // by for d in domain)
        places = [source(isometry, c, r, n) for r in range(n) for c in range(n)]
        block = [h[top + r * apart][left + c * apart] for c, r in places]
        total = 0.0
        for v in block:
            total += v
        s = scale / tile.scale_max
        offset = tile.mean(mean) - s * (total / (n * n))
        for k, v in enumerate(block):
            y, z = row * n + k // n, col * n + k % n
            new = offset + s * v
            change += abs(new - x[y][z])
            x[y][z] = new
    return change / (len(x) * len(x[0]))


def samples(tile, leaves):
    """The fixed point at zoom 1."""
    by = 2
    means, apart = (half, 1) if tile.jump % 4 == 0 else (boxes, 2)
    cols, rows = (n // by for n in tile.padded)
    seed = tile.least / 2 + tile.greatest / 2
    x = [[seed] * cols for _ in range(rows)]
    constant = [leaf for leaf in leaves if leaf[3] == 0]
    for (col, row), side, *_ in constant:
        if side < by:
            x[row // by][col // by] = 0.0
    apply(tile, constant, x, None, by)
    maps = [leaf for leaf in leaves if leaf[3] != 0]
    for _ in range(64):
        if apply(tile, maps, x, means(x), by, apart) < 0.002:
            break
    whole = [[0.0] * tile.padded[0] for _ in range(tile.padded[1])]
    apply(tile, leaves, whole, x, 1)
    return whole


def main():
    tile = Tile(open(sys.argv[1], "rb").read())
    coder = Coder(tile.body)
    void = read_mask(tile, coder)
    leaves = Tree(tile, coder).leaves
    q = read_residual(tile, coder, void)
    if len(leaves) != tile.maps:
        sys.exit(f"{len(leaves)} maps came, the head says {tile.maps}")
    x = samples(tile, leaves)

    def height(row, col):
        if void[row][col]:
            return "-9999999"
        k = x[row][col]
        if tile.bound is not None:
            k = math.copysign(math.floor(abs(k) + 0.5), k) + q[row][col] * (2 * tile.bound + 1)
        return repr(tile.base + tile.unit * k)

    with open(sys.argv[2], "w") as out:
        out.write(f"ncols {tile.cols}\nnrows {tile.rows}\n")
        out.write(f"xllcenter {tile.x0}\nyllcenter {tile.y0 + tile.dy * (tile.rows - 1)}\n")
        out.write(f"cellsize {tile.dx}\nnodata_value -9999999\n")
        for row in range(tile.rows):
            out.write(" ".join(height(row, col) for col in range(tile.cols)) + "\n")
    error = tile.given + tile.unit * (tile.error_max if tile.bound is None else tile.bound)
    print(f"{tile.cols} x {tile.rows} samples of {len(leaves)} maps, off by {error} at most; {tile.source}")


if __name__ == "__main__":
    main()
