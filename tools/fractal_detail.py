"""Synthetic detail beside the truth: acceptance F7 of the specification, measured here by numpy's FFT and Pillow's bicubic interpolation.

The example `detail` of codecs/ reduces a grid by 2 and by 4, encodes it with ranges of 4 alone and writes what comes back. Only those grids are taken
from it; the reduced grid, the interpolation to compare with and all numbers are made here.
"""

import struct
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from fractal_grids import PARTS, box, terrain
from PIL import Image

WAYS = ["doubled", "plain", "controlled"]


def bicubic(z, factor):
    size = (z.shape[1] * factor, z.shape[0] * factor)
    return np.asarray(Image.fromarray(z.astype(np.float32)).resize(size, Image.Resampling.BICUBIC), float)


def powers(z, octaves):
    """Power of the octaves, the finest last: least-squares plane removed, Hann window, rings of frequency."""
    rows, cols = z.shape
    y, x = np.mgrid[0:rows, 0:cols]
    a = np.stack([np.ones(z.size), x.ravel(), y.ravel()], 1)
    z = z - (a @ np.linalg.lstsq(a, z.ravel(), rcond=None)[0]).reshape(z.shape)
    hann = lambda n: np.hanning(n + 2)[1:-1]
    power = np.abs(np.fft.fft2(z * hann(rows)[:, None] * hann(cols))) ** 2
    f = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.fftfreq(cols))
    return [power[(f >= 0.5 / 2**o) & (f < 1 / 2**o)].sum() for o in range(octaves, 0, -1)]


def whole(z):
    """Rounded as the example does it: halves away from zero."""
    return np.sign(z) * np.floor(np.abs(z) + 0.5)


def rms(a, b):
    return np.sqrt(np.mean((a - b) ** 2))


def came_back(program, z, *options):
    """What the example makes of a grid: (factor, way) to heights."""
    with tempfile.TemporaryDirectory() as folder:
        grid = Path(folder, "grid")
        grid.write_bytes(struct.pack("<II", z.shape[1], z.shape[0]) + z.astype("<i4").tobytes())
        command = [program, *options, "--into", folder, str(grid)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        out = {}
        for factor in (2, 4):
            for way in WAYS:
                data = Path(folder, f"grid.{factor}.{way}").read_bytes()
                cols, rows = struct.unpack("<II", data[:8])
                out[factor, way] = np.frombuffer(data[8:], "<f8").reshape(rows, cols)
        return out


def judged(program, name, *options):
    """Error against bicubic's and powers against the true ones, by (factor, way)."""
    z = terrain(name)
    back = came_back(program, z, *options)
    out = {}
    for factor in (2, 4):
        small, octaves = z, factor // 2
        for _ in range(octaves):
            small = box(small)
        simple = bicubic(whole(small), factor)
        own, reference = powers(z, octaves), rms(simple, z)
        for way, got in [("bicubic", simple)] + [(w, back[factor, w]) for w in WAYS]:
            out[factor, way] = rms(got, z) / reference, [p / o for p, o in zip(powers(got, octaves), own)]
        mean = back[factor, "controlled"]
        for _ in range(octaves):
            mean = box(mean)
        if "--bound" in options and np.abs(mean - whole(small)).max() > 1e-6:
            raise SystemExit(f"{name}: means over cells are not the tile")
    return out


def holds(error, octaves):
    return error <= 1.25 and all(0.7 <= p <= 1.4 for p in octaves)


def cells(found):
    error, octaves = found
    return f"{error:.2f}", " ".join(f"{p:.2f}" for p in octaves)


def line(*cells):
    return "| " + " | ".join(map(str, cells)) + " |"


def table(program):
    """F7, the tile without loss."""
    heads = [c for w in ("mean-keeping", "plain IFS", "gain-controlled IFS") for c in (f"{w}: error", "power")]
    yield line("grid", "part", "reduced", *heads, "F7")
    yield line(*["---"] * 10)
    reached = {}
    for part, names in PARTS.items():
        for name in names:
            found = judged(program, name, "--bound", "0")
            for factor in (2, 4):
                ok = holds(*found[factor, "controlled"])
                reached.setdefault((factor, part), []).append(ok)
                columns = [c for w in WAYS for c in cells(found[factor, w])]
                yield line(name, part, f"{factor} x", *columns, "reached" if ok else "missed")
    yield ""
    for factor in (2, 4):
        shares = [f"{sum(reached[factor, p])} of {len(reached[factor, p])} (part: {p})" for p in PARTS]
        yield f"- reduced {factor} x, F7 is reached on {', '.join(shares)}"


def without_residual(program):
    """The same where the tile holds nothing but its maps."""
    heads = [c for w in ("plain IFS", "gain-controlled IFS") for c in (f"{w}: error", "power")]
    yield line("grid", "reduced", *heads)
    yield line(*["---"] * 6)
    for name in PARTS["form"]:
        found = judged(program, name)
        for factor in (2, 4):
            yield line(name, f"{factor} x", *(c for w in WAYS[1:] for c in cells(found[factor, w])))
