#!/usr/bin/env python3
"""Terrain below its sample distance: docs/pictures/fractal_zoom.png.

    python3 -m venv target/python && target/python/bin/pip install -r tools/compare_gtb_requirements.txt
    target/python/bin/python tools/fractal_pictures.py [--out docs/pictures/fractal_zoom.png]

A crop of a DEM is reduced by 8, encoded without loss with ranges of 4 alone, and brought back to its size in five ways, hill-shaded, beside the truth.
Needs the shared data beside the checkout and cargo, which builds an example of codecs/. Prints the numbers of the captions.
"""

import argparse
import struct
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from compare_fractal import build
from fractal_detail import bicubic, powers, rms, whole
from fractal_grids import box
from gtb_grids import ELEVATION, ROOT
from gtb_pictures import shade
from PIL import Image, ImageDraw, ImageFont

GRID, SPACING, UNIT = "Elk Mts", 10.0, 0.1  # metres between posts, metres a unit
FACTOR = 8
SHOWN = (slice(128, 384), slice(128, 384))  # rows and columns
SIDE = 448  # pixels of a panel


def came_back(z):
    """The reduced grid, and what the example makes of it."""
    small = z
    for _ in range(FACTOR.bit_length() - 1):
        small = box(small)
    with tempfile.TemporaryDirectory() as folder:
        grid = Path(folder, "grid")
        grid.write_bytes(struct.pack("<II", z.shape[1], z.shape[0]) + z.astype("<i4").tobytes())
        command = [build("detail"), "--bound", "0", "--factors", str(FACTOR), "--into", folder, grid]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        read = lambda way: np.frombuffer(Path(folder, f"grid.{FACTOR}.{way}").read_bytes()[8:], "<f8").reshape(z.shape)
        return whole(small), {way: read(way) for way in ("doubled", "plain", "controlled")}


def panel(z, caption, numbers, font, small_font):
    lit = Image.fromarray((255 * shade(z * UNIT, SPACING)[SHOWN]).astype(np.uint8))
    out = Image.new("L", (SIDE, SIDE + 52), 255)
    out.paste(lit.resize((SIDE, SIDE), Image.Resampling.BILINEAR), (0, 52))
    pen = ImageDraw.Draw(out)
    pen.text((4, 2), caption, 0, font)
    pen.text((4, 28), numbers, 70, small_font)
    return out


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", default=ROOT / "docs/pictures/fractal_zoom.png")
    arguments = parser.parse_args()
    z = ELEVATION[GRID][1]().astype(float)[:512, :512]
    small, back = came_back(z)
    octaves = FACTOR.bit_length() - 1
    own = powers(z, octaves)
    ways = [
        ("pixels", np.kron(small, np.ones((FACTOR, FACTOR)))),
        ("bicubic", bicubic(small, FACTOR)),
        ("plain IFS", back["plain"]),
        ("means kept, gain 0: no detail", back["doubled"]),
        ("gain-controlled IFS: synthetic detail", back["controlled"]),
        ("truth", z),
    ]
    font, small_font = ImageFont.load_default(20), ImageFont.load_default(14)
    sheet = Image.new("L", (3 * SIDE + 16, 2 * (SIDE + 52) + 8), 255)
    for k, (caption, got) in enumerate(ways):
        shares = " ".join(f"{p / o:.2f}" for p, o in zip(powers(got, octaves), own))
        numbers = f"error {rms(got, z) * UNIT:.1f} m rms, power of the three new octaves: {shares}"
        if got is z:
            numbers = "posts every 10 m; the others had every 80 m"
        print(f"{caption}: {numbers}")
        sheet.paste(panel(got, caption, numbers, font, small_font), (k % 3 * (SIDE + 8), k // 3 * (SIDE + 60)))
    sheet.save(arguments.out, optimize=True)


if __name__ == "__main__":
    main()
