#!/usr/bin/env python3
"""Pictures of what few bytes of terrain look like: docs/pictures/gtb_20kB.png and docs/pictures/gtb_joint.png.

    python3 -m venv target/python && target/python/bin/pip install -r tools/compare_gtb_requirements.txt
    target/python/bin/python tools/gtb_pictures.py bytes [--raw PROGRAM] [--out docs/pictures/gtb_20kB.png]
    target/python/bin/python tools/gtb_pictures.py joint PROGRAM [--out docs/pictures/gtb_joint.png]

`bytes`: the San Gabriel Mountains (SRTM, 513 x 513 posts) in 20 000 bytes as the beginning of a GTB stream, as JPEG 2000 and as a
mesh, hill-shaded; all is coded, a part is shown. `joint`: San Francisco, heights and picture in one stream of `terraquilt gtb`, cut at 1, 5, 25 and 100 %. Needs the
shared data beside the checkout; prints the numbers of the captions.
"""

import argparse
import gzip
import json
import subprocess
import tempfile
from pathlib import Path

import imagecodecs as ic
import numpy as np
import rasterio
from compare_gtb import fault, search, steps
from gtb_grids import DATA, ELEVATION, ROOT, Raw, build_raw
from PIL import Image, ImageDraw, ImageFont
from pydelatin import Delatin

BUDGET = 20_000
SHOWN = (slice(120, 408), slice(90, 378))  # rows and columns
SPACING = 30.0  # metres between posts
JOINT = ("dem/sanfrancisco_usgs_1s.tif", "imagery/sfbay_landsat7_rgb.tif")
UNIT = 0.1  # metres; the file's heights are floats of no declared precision


def shade(z, spacing):
    """Light from the north-west, 0 to 1."""
    gy, gx = np.gradient(z, spacing)
    light = np.array([-0.55, -0.55, 0.63])
    return np.clip((-gx * light[0] - gy * light[1] + light[2]) / np.sqrt(1 + gx * gx + gy * gy), 0, 1)


def varints(numbers):
    """Signed numbers as zigzag bytes of seven bits."""
    out = bytearray()
    for n in map(int, numbers):
        n = n << 1 if n >= 0 else (-n << 1) - 1
        while n >= 128:
            out.append(n & 127 | 128)
            n >>= 7
        out.append(n)
    return bytes(out)


def mesh_bytes(vertices, triangles):
    """A mesh in the usual form: vertices in the order of first use, coordinates as differences, indices against the greatest so
    far, gzip. Triangles follow a curve through the plane."""
    centre = vertices[triangles].mean(1).astype(int)
    spread = lambda v: sum(((v >> k) & 1) << (2 * k) for k in range(11))
    triangles = triangles[np.argsort(spread(centre[:, 0]) | spread(centre[:, 1]) << 1)]
    _, first = np.unique(triangles, return_index=True)
    order = np.argsort(first)
    number = np.empty(len(vertices), int)
    number[np.unique(triangles)[order]] = np.arange(len(order))
    placed = vertices[np.unique(triangles)[order]].astype(int)
    indices = number[triangles].ravel()
    greatest = np.maximum.accumulate(np.concatenate([[-1], indices[:-1]])) + 1
    columns = [varints(np.diff(placed[:, k], prepend=0)) for k in range(3)]
    return len(gzip.compress(b"".join(columns) + varints(greatest - indices), 9)), len(order)


def mesh_heights(vertices, triangles, shape):
    """The surface of a mesh at the posts."""
    out = np.full(shape, np.nan)
    for a, b, c in vertices[triangles]:
        low = np.ceil(np.minimum(np.minimum(a, b), c)[:2]).astype(int)
        high = np.floor(np.maximum(np.maximum(a, b), c)[:2]).astype(int)
        x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if area == 0:
            continue
        v = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
        w = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
        inside = (v >= -1e-9) & (w >= -1e-9) & (v + w <= 1 + 1e-9)
        z = a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2])
        out[y[inside], x[inside]] = z[inside]
    assert not np.isnan(out).any(), "the mesh leaves posts uncovered"
    return out


def mesh(z):
    """The finest mesh of pydelatin within the budget."""

    def made(bound):
        m = Delatin(z.astype(np.float32), max_error=float(bound))
        vertices = m.vertices.astype(float)
        vertices[:, 1] = z.shape[0] - 1 - vertices[:, 1]  # its rows count from the south
        return vertices, m.triangles.astype(int)

    bound = -search(lambda b: mesh_bytes(*made(-b))[0], BUDGET, -500.0, -1.0)
    vertices, triangles = made(bound)
    size, _ = mesh_bytes(vertices, triangles)
    return size, f"mesh, {len(triangles):,} triangles", mesh_heights(vertices, triangles, z.shape)


def jpeg_2000(z):
    q, back = steps(z, 0)
    code = lambda level: ic.jpeg2k_encode(q, level, reversible=False, codecformat="j2k", resolutions=6, numthreads=1)
    data = code(search(lambda v: len(code(v)), BUDGET, 20, 150))
    return len(data), "JPEG 2000", back(ic.jpeg2k_decode(data))


def gtb(z, raw):
    """The beginning of a stream without loss in the end, whose first layer just fits."""

    def code(bound):
        return raw.encode(z, "cubic", [bound, 0])

    first = lambda bound: [e[1] for e in code(bound)["ends"] if e[0] == 0][-1]
    bound = round(-search(lambda b: first(round(-b)), BUDGET, -127, -1))
    whole = code(bound)["bytes"]
    out, said = raw.decode(BUDGET)
    if fault(out, z)[1] > said["error_bound"]:
        raise SystemExit(f"the prefix is {fault(out, z)[1]} off and says {said['error_bound']}")
    return BUDGET, f"GTB, the beginning of {whole:,} bytes, certified to {said['error_bound']} m", out


def label(panel, lines, size=15):
    """A picture with lines of text below it."""
    font = ImageFont.load_default(size)
    step = size + 4
    out = Image.new(panel.mode, (panel.width, panel.height + step * len(lines) + 6), "white")
    out.paste(panel, (0, 0))
    draw = ImageDraw.Draw(out)
    for k, text in enumerate(lines):
        draw.text((2, panel.height + 2 + k * step), text, fill="black", font=font)
    return out


def tile(panels, columns, gap=8):
    """Panels of one size in rows."""
    w, h = panels[0].size
    rows = -(-len(panels) // columns)
    out = Image.new(panels[0].mode, (columns * (w + gap) - gap, rows * (h + gap) - gap), "white")
    for k, panel in enumerate(panels):
        out.paste(panel, (k % columns * (w + gap), k // columns * (h + gap)))
    return out


def save(picture, out, colours):
    picture.quantize(colours).save(out, optimize=True)
    print(f"{out}: {Path(out).stat().st_size} bytes, {picture.width} x {picture.height}")


def bytes_picture(raw, out):
    z = ELEVATION["San Gabriel"][1]()
    panels = [(z.astype(float), ["San Gabriel Mountains, SRTM 30 m", f"{2 * z.size:,} bytes as 16 bit integers"])]
    for size, name, heights in (gtb(z, raw), jpeg_2000(z), mesh(z)):
        rms, greatest = fault(heights, z)
        panels.append((heights, [name, f"{size:,} bytes: greatest error {greatest:.0f} m, rms {rms:.1f} m"]))
    shown = []
    for heights, text in panels:
        print(*text, sep="; ")
        lit = Image.fromarray((255 * shade(heights, SPACING)[SHOWN]).astype(np.uint8))
        shown.append(label(lit.resize((480, 480), Image.BICUBIC), text))
    save(tile(shown, 2), out, 32)


def joint_picture(program, out):
    dem, image = (DATA / name for name in JOINT)
    with rasterio.open(dem) as source:
        truth = source.read(1).astype(float)
    with tempfile.TemporaryDirectory() as folder:

        def run(*args):
            done = subprocess.run([program, "gtb", *map(str, args), "--json"], check=True, stdout=subprocess.PIPE, text=True)
            return json.loads(done.stdout.splitlines()[-1])

        stream = f"{folder}/sf.gtb"
        run("encode", dem, stream, "--unit", UNIT, "--layers", "13,4,1,0", "--image", image)
        whole = Path(stream).stat().st_size
        shown = []
        for percent in (1, 5, 25, 100):
            n = whole * percent // 100
            said = run("decode", stream, f"{folder}/cut.tif", "--bytes", n)
            run("decode", stream, f"{folder}/cut.png", "--bytes", n)
            with rasterio.open(f"{folder}/cut.tif") as source:
                greatest = np.abs(source.read(1).astype(float) - truth).max()
            if greatest > said["error_bound"] * (1 + 1e-6):
                raise SystemExit(f"{percent} % is {greatest} m off and says {said['error_bound']} m")
            text = [f"{percent} %: {n:,} bytes", f"greatest error {greatest:.2f} m, certified {said['error_bound']:.2f} m"]
            print(*text, sep="; ")
            picture = Image.open(f"{folder}/cut.png").convert("RGB")
            width = 480
            panel = picture.resize((width, round(picture.height * width / picture.width)), Image.LANCZOS)
            shown.append(label(panel, text))
    save(tile(shown, 2), out, 128)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["bytes", "joint"])
    parser.add_argument("program", nargs="?", default=ROOT / "target/release/terraquilt", help="terraquilt, for 'joint'")
    parser.add_argument("--raw", help="the example program 'raw' of codecs/, for 'bytes'; default: cargo builds it")
    parser.add_argument("--out")
    arguments = parser.parse_args()
    if arguments.what == "bytes":
        bytes_picture(Raw(arguments.raw or build_raw()), arguments.out or ROOT / "docs/pictures/gtb_20kB.png")
    else:
        joint_picture(arguments.program, arguments.out or ROOT / "docs/pictures/gtb_joint.png")


if __name__ == "__main__":
    main()
