#!/usr/bin/env python3
"""GTB beside other coders of grids at equal greatest error: the tables of docs/gtb.md.

    python3 -m venv target/python && target/python/bin/pip install -r tools/compare_gtb_requirements.txt
    target/python/bin/python tools/compare_gtb.py [--quick] [--raw PROGRAM] [--into docs/gtb.md]

Needs the shared data beside the checkout and cargo (or --raw: codecs/examples/raw.rs, built). --into replaces the part of the
file between the marks of this tool. --quick: the three grids that the specification names, without speeds. Every number is of an
answer that was decoded again and compared with the heights, post by post; a coder beyond its bound ends the run.

JPEG XL, JPEG 2000 and PNG have no bound on the error: heights are rounded to multiples of 2E+1 and coded without loss. SZ3 and SPERR
get E + 0.49 and their answer is rounded to integers. JPEG-LS and LERC have bounds of their own.
"""

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path

import imagecodecs as ic
import numpy as np
from gtb_grids import ELEVATION, SURFACE, VOID, Raw, Refused, build_raw, everest_voids

BOUNDS = [0, 1, 10]
OURS = ["cubic", "adaptive"]
CUTS = [2, 7, 30, 60, 95]  # percent of a stream; what each says of its error is checked too
NAMED = ["Fuji", "San Gabriel", "White Mts"]
# Bits a sample of the specification's prototype, section 5: cubic, adaptive.
PROTOTYPE = {
    ("Fuji", 0): (3.713, 3.670), ("Fuji", 1): (2.250, 2.236), ("Fuji", 10): (0.491, 0.526),
    ("San Gabriel", 0): (3.186, 3.006), ("San Gabriel", 1): (1.804, 1.719), ("San Gabriel", 10): (0.377, 0.384),
    ("White Mts", 0): (3.409, 3.291), ("White Mts", 10): (0.387, 0.404), ("fault", 0): (4.660, 4.475),
    ("Elk Mts", 0): (4.286, 3.994), ("Elk Mts", 10): (0.850, 0.852), ("Slovenia", 0): (4.486, 4.505),
    ("NRW", 0): (7.539, 7.565),
}  # fmt: skip


def steps(z, bound):
    """Heights as unsigned numbers of steps of 2E+1, and the way back."""
    low, step = int(z.min()), 2 * bound + 1
    q = (z.astype(np.int64) - low + bound) // step
    return q.astype(np.uint16), lambda out: out.astype(np.int64) * step + low


def jpeg_xl(z, bound):
    q, back = steps(z, bound)
    data = ic.jpegxl_encode(q, lossless=True, effort=9, numthreads=1)
    return data, lambda: back(ic.jpegxl_decode(data, numthreads=1))


def jpeg_2000(z, bound):
    q, back = steps(z, bound)
    depth = max(1, int(q.max()).bit_length())
    data = ic.jpeg2k_encode(q, reversible=True, codecformat="j2k", resolutions=6, bitspersample=depth, numthreads=1)
    return data, lambda: back(ic.jpeg2k_decode(data, numthreads=1))


def png16(z, bound):
    q, back = steps(z, bound)
    data = ic.png_encode(q, 9, filter=248)  # all filters, chosen row by row
    return data, lambda: back(ic.png_decode(data))


def jpeg_ls(z, bound):
    low = int(z.min())
    data = ic.jpegls_encode((z - low).astype(np.uint16), bound)
    return data, lambda: ic.jpegls_decode(data).astype(np.int64) + low


def lerc(z, bound):
    data = ic.lerc_encode(z, bound)
    return data, lambda: ic.lerc_decode(data)


def sz3(z, bound):
    real = z.astype(np.float32)
    data = ic.sz3_encode(real, "abs", bound + 0.49)
    return data, lambda: np.rint(ic.sz3_decode(data, real.shape, real.dtype))


def sperr(z, bound):
    data = ic.sperr_encode(z.astype(np.float32), bound + 0.49, "pwe", numthreads=1)
    return data, lambda: np.rint(ic.sperr_decode(data, numthreads=1))


RIVALS = {
    "JPEG XL e9": (jpeg_xl, ic.JPEGXL, "jpegxl"), "JPEG-LS": (jpeg_ls, ic.JPEGLS, "jpegls"),
    "JPEG 2000": (jpeg_2000, ic.JPEG2K, "jpeg2k"), "SZ3": (sz3, ic.SZ3, "sz3"), "SPERR": (sperr, ic.SPERR, "sperr"),
    "LERC": (lerc, ic.LERC, "lerc"), "PNG16": (png16, ic.PNG, "png"),
}  # fmt: skip


@cache
def absent(what, sentence):
    """A profile that the program refuses is left out, and named."""
    print(f"left out: {what}: {sentence}", file=sys.stderr)


def check(name, z, out, bound):
    error = int(np.abs(out.astype(np.int64) - z).max())
    if error > bound:
        raise SystemExit(f"{name} is {error} units off, {bound} were asked for")


def rival(name, z, bound):
    """Bytes, seconds of encoding and of decoding."""
    begun = time.perf_counter()
    data, decode = RIVALS[name][0](z, bound)
    encoded = time.perf_counter()
    out = decode()
    decoded = time.perf_counter()
    check(name, z, out, bound)
    return len(data), encoded - begun, decoded - encoded


def ours(raw, profile, z, layers):
    """The same of GTB; nothing where the program refuses, with its sentence on stderr."""
    try:
        made = raw.encode(z, profile, layers)
    except Refused as sentence:
        absent(f"{profile} {layers}", str(sentence))
        return None
    out, said = raw.decode()
    check(f"GTB {profile}", z, out, layers[-1])
    for part in CUTS:
        out, cut = raw.decode(max(300, made["bytes"] * part // 100))  # heads are shorter
        error = np.abs(out - z).max()
        if error > cut["error_bound"]:
            raise SystemExit(f"GTB {profile} {layers}: {part} % is {error} units off and says {cut['error_bound']}")
    return made["bytes"], made["seconds"], said["seconds"]


def one(job):
    """One grid at one bound: bits a sample by coder."""
    program, name, bound = job
    z = (ELEVATION | SURFACE)[name][1]()
    raw = Raw(program)
    got = {p: ours(raw, p, z, [bound]) for p in OURS}
    if bound == 0:
        got |= {f"{p} layers": ours(raw, p, z, [13, 4, 1, 0]) for p in OURS}
    got |= {r: rival(r, z, bound) for r in RIVALS if RIVALS[r][1].available}
    return name, bound, z.shape[0], {k: v[0] * 8 / z.size for k, v in got.items() if v}


def cell(value, best=False):
    return "-" if value is None else f"**{value:.3f}**" if best else f"{value:.3f}"


def better(bits):
    return min(bits[p] for p in OURS if p in bits)


def opponent(bits, bound):
    """What the specification measures against: JPEG XL e9; at greater errors the best of three."""
    return min(bits[r] for r in (["JPEG XL e9"] if bound < 10 else ["JPEG XL e9", "SZ3", "SPERR"]) if r in bits)


def line(*cells):
    return "| " + " | ".join(map(str, cells)) + " |"


def table(results, grids, bound):
    columns = [*(f"GTB {p}" for p in OURS), *RIVALS]
    against = "JPEG XL" if bound < 10 else "best of SZ3, SPERR, JPEG XL"
    yield line("grid", "posts", *columns, f"better profile / {against}")
    yield line(*["---"] * (len(columns) + 3))
    for name in grids:
        side, bits = results[name, bound]
        all_of = [bits.get(k) for k in [*OURS, *RIVALS]]
        least = min(b for b in all_of if b is not None)
        cells = [cell(b, b == least) for b in all_of]
        what = (ELEVATION | SURFACE)[name][0]
        yield line(f"{name}, {what}", f"{side}²", *cells, f"{better(bits) / opponent(bits, bound):.3f}")


def ratios(results, grids, bound):
    return [better(results[g, bound][1]) / opponent(results[g, bound][1], bound) for g in grids]


def means(results, grids):
    yield line("E", "better profile against", "grids", "mean", "least", "greatest", "wanted of the mean")
    yield line(*["---"] * 7)
    for bound, wanted in zip(BOUNDS, ["0.97", "0.93", "0.80"]):
        against = "JPEG XL e9" if bound < 10 else "best of SZ3, SPERR, JPEG XL e9"
        r = ratios(results, grids, bound)
        yield line(bound, against, len(r), f"**{np.mean(r):.3f}**", f"{min(r):.3f}", f"{max(r):.3f}", wanted)
    r = ratios(results, NAMED, 10)
    yield line(10, "the same, on " + ", ".join(NAMED), 3, f"**{np.mean(r):.3f}**", f"{min(r):.3f}", f"{max(r):.3f}", "0.72")


def prototype(results):
    yield line("grid", "E", "cubic", "prototype", "ratio", "adaptive", "prototype", "ratio")
    yield line(*["---"] * 8)
    for (name, bound), expected in PROTOTYPE.items():
        if (name, bound) in results:
            bits = results[name, bound][1]
            pairs = zip([bits.get(p) for p in OURS], expected)
            yield line(name, bound, *(c for b, e in pairs for c in (cell(b), f"{e:.3f}", cell(b and b / e))))


def layers(results, grids):
    yield line("grid", *(c for p in OURS for c in (f"{p}, one layer", "13, 4, 1, 0", "ratio")))
    yield line(*["---"] * (1 + 3 * len(OURS)))
    for name in grids:
        bits = results[name, 0][1]
        cells = []
        for p in OURS:
            one_layer, four = bits.get(p), bits.get(f"{p} layers")
            cells += [cell(one_layer), cell(four), cell(four / one_layer if one_layer and four else None)]
        yield line(name, *cells)


def nearest_filled(z):
    """Voids take the height of the nearest post to the west, else of the nearest row that has one."""
    known = z != VOID
    at = np.maximum.accumulate(np.where(known, np.arange(z.shape[1]), 0), axis=1)
    rows = np.take_along_axis(z, at, 1)
    good = np.where(rows != VOID, np.arange(len(z))[:, None], 0)
    return np.take_along_axis(rows, np.maximum.accumulate(good, axis=0), 0)


def smoothly_filled(z):
    """Voids as a membrane: the mean of their neighbours, a thousand sweeps."""
    known = z != VOID
    out = np.where(known, z, z[known].mean()).astype(float)
    for _ in range(1000):
        p = np.pad(out, 1, mode="edge")
        out = np.where(known, z, (p[:-2, 1:-1] + p[2:, 1:-1] + p[1:-1, :-2] + p[1:-1, 2:]) / 4)
    return np.rint(out).astype(np.int32)


def voids(program):
    z = everest_voids()
    known = z != VOID
    raw = Raw(program)
    yield line("coder", "bits a sample")
    yield line("---", "---")
    for profile in OURS:
        try:
            made = raw.encode(z, profile, [0])
        except Refused as sentence:
            absent(f"voids, {profile}", str(sentence))
            continue
        out, _ = raw.decode()
        if not ((np.isnan(out) == ~known).all() and (out[known] == z[known]).all()):
            raise SystemExit(f"voids, {profile}: heights or voids came out as others")
        yield line(f"GTB {profile}, mask and heights", f"**{made['bytes'] * 8 / z.size:.3f}**")
    mask = len(ic.jpegxl_encode(known.astype(np.uint8), lossless=True, effort=9, bitspersample=1)) * 8 / z.size
    fills = {
        "a constant below all": np.where(known, z, z[known].min() - 1),
        "their western neighbour": nearest_filled(z),
        "a membrane": smoothly_filled(z),
    }
    for name, filled in fills.items():
        bits = rival("JPEG XL e9", filled, 0)[0] * 8 / z.size
        alone = name.startswith("a constant")
        yield line(f"JPEG XL e9, voids filled with {name}" + ("" if alone else f", its mask {mask:.3f}"),
                   f"{bits + (0 if alone else mask):.3f}")  # fmt: skip


def search(size_of, budget, low, high):
    """The greatest parameter whose size is within the budget; sizes grow with the parameter."""
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if size_of(middle) <= budget else (low, middle)
    return low


def fault(out, z):
    d = out.astype(float) - z
    return np.sqrt((d * d).mean()), np.abs(d).max()


def low_rates(program):
    """rms and greatest error on San Gabriel at the bytes of 0.5 and 0.05 bits a sample."""
    z = ELEVATION["San Gabriel"][1]()
    q, back = steps(z, 0)
    real = z.astype(np.float32)
    raw = Raw(program)
    yield line("bits a sample", "coder", "used", "rms", "greatest error")
    yield line(*["---"] * 5)
    for rate in [0.5, 0.05]:
        budget = int(rate * z.size / 8)
        rows = []

        def j2k(level):
            return ic.jpeg2k_encode(q, level, reversible=False, codecformat="j2k", resolutions=6, numthreads=1)

        data = j2k(search(lambda v: len(j2k(v)), budget, 20, 150))
        rows.append(("JPEG 2000 9/7", len(data), *fault(back(ic.jpeg2k_decode(data)), z)))
        data = ic.sperr_encode(real, search(lambda b: len(ic.sperr_encode(real, b, "bpp")), budget, 0.001, rate * 2), "bpp")
        rows.append(("SPERR", len(data), *fault(ic.sperr_decode(data), z)))
        for profile in OURS:
            try:
                for what, bounds in [("cut", [0]), ("cut of layers 40, 13, 4, 1, 0", [40, 13, 4, 1, 0])]:
                    raw.encode(z, profile, bounds)
                    rows.append((f"GTB {profile}, {what}", budget, *fault(raw.decode(budget)[0], z)))
                bound = -search(lambda e: raw.encode(z, profile, [round(-e)])["bytes"], budget, -400, 0)
                bytes_of = raw.encode(z, profile, [round(bound)])["bytes"]
                rows.append((f"GTB {profile}, whole at E = {round(bound)}", bytes_of, *fault(raw.decode()[0], z)))
            except Refused as sentence:
                absent(f"low rates, {profile}", str(sentence))
        for name, bytes_of, rms, greatest in rows:
            yield line(rate, name, f"{bytes_of * 8 / z.size:.3f}", f"{rms:.1f} m", f"{greatest:.0f} m")


def speeds(program):
    """Seconds as multiples of those of GTB cubic, in this run, on one core."""
    z = ELEVATION["White Mts"][1]()
    raw = Raw(program)
    yield line("coder", "encode E = 0", "decode E = 0", "encode E = 10", "decode E = 10")
    yield line(*["---"] * 5)
    coders = {f"GTB {p}": (lambda b, p=p: ours(raw, p, z, [b])) for p in OURS}
    coders |= {r: (lambda b, r=r: rival(r, z, b)) for r in RIVALS if RIVALS[r][1].available}
    rows = {}
    for name, coder in coders.items():
        best = []
        for bound in (0, 10):
            runs = [coder(bound) for _ in range(1 if name == "JPEG XL e9" else 5)]
            best += [min(r[k] for r in runs) if all(runs) else None for k in (1, 2)]
        rows[name] = best
    for name, row in rows.items():
        yield line(name, *("-" if v is None else f"{v / base:.2f}" for v, base in zip(row, rows["GTB cubic"])))


def document(results, program, quick):
    grids = [g for g in ELEVATION if (g, 0) in results]
    missing = [r for r in RIVALS if not RIVALS[r][1].available]
    versions = ", ".join(
        f"{r} {getattr(ic, f'{tag}_version')()}" for r, (_, module, tag) in RIVALS.items() if module.available
    )
    yield f"Rivals from imagecodecs {ic.__version__}: {versions}." + (f" Absent here: {', '.join(missing)}." if missing else "")
    yield "Bits a sample; the least of a row is bold."
    for bound in BOUNDS:
        yield f"\n### Greatest error {bound}\n" if bound else "\n### Without loss\n"
        yield from table(results, grids, bound)
    yield "\n### Means\n"
    yield from means(results, grids)
    if not quick:
        yield "\n### Surface models, with roofs and trees\n"
        for bound in BOUNDS:
            yield f"\nE = {bound}:\n"
            yield from table(results, list(SURFACE), bound)
    yield "\n### Voids: the window of Everest of which 15.8 % is void, without loss\n"
    yield from voids(program)
    yield "\n### Low rates, San Gabriel\n"
    yield from low_rates(program)
    yield "\n### Layers, without loss in the end\n"
    yield from layers(results, grids)
    yield "\n### Beside the prototype of the specification\n"
    yield from prototype(results)
    if not quick:
        yield "\n### Time, as multiples of GTB cubic's, White Mts, one core\n"
        yield from speeds(program)


def into(path, text):
    """Replaces what stands between the marks of this tool."""
    begin, end = "<!-- tools/compare_gtb.py -->\n", "<!-- end of tools/compare_gtb.py -->\n"
    old = Path(path).read_text()
    head, rest = old.split(begin)
    Path(path).write_text(f"{head}{begin}{text}{end}{rest.split(end)[1]}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="three grids, no speeds")
    parser.add_argument("--raw", help="the example program 'raw' of codecs/; default: cargo builds it")
    parser.add_argument("--into", help="a file with the marks of this tool; default: print")
    arguments = parser.parse_args()
    program = arguments.raw or build_raw()
    grids = NAMED if arguments.quick else [*ELEVATION, *SURFACE]
    with ProcessPoolExecutor(2) as pool:
        done = pool.map(one, [(program, g, b) for g in grids for b in BOUNDS])
        results = {(name, bound): (side, bits) for name, bound, side, bits in done}
    text = "\n".join(document(results, program, arguments.quick)) + "\n"
    into(arguments.into, text) if arguments.into else print(text, end="")


if __name__ == "__main__":
    main()
