#!/usr/bin/env python3
"""Fractal tiles beside the paper and beside other coders: the tables of docs/fractal.md.

    python3 -m venv target/python && target/python/bin/pip install -r tools/compare_gtb_requirements.txt
    target/python/bin/python tools/compare_fractal.py PROGRAM [--only table1,table2,F1,F7] [--into docs/fractal.md]

PROGRAM is a release build of `terraquilt`. Needs the shared data beside the checkout and cargo, which builds examples of codecs/. --into
replaces the part of the file between the marks of this tool. Sizes are those of real files; everything is decoded again and compared with
its source here. Pictures go through PROGRAM, distance fields through the example `solids`, which gives the field away, too.
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import fractal_detail
import numpy as np
from fractal_detail import line
from fractal_grids import MESHES, PICTURES
from fractal_rivals import at, lossless_jpeg_xl, psnr
from gtb_grids import ROOT
from PIL import Image

# Table 1 of the paper: model, parameters, seconds, PSNR, ratio; and what stands for the model here.
TABLE_1 = [
    ("Lenna", "const range2", 14.000, 49.79, 0.81, ["photo"]),
    ("Lenna", "const range1", 64.891, 60.77, 0.20, ["photo"]),
    ("Lenna", "quad 5000", 11.750, 37.74, 2.56, ["photo"]),
    ("Lenna", "quad 10000", 22.454, 44.75, 1.28, ["photo"]),
    ("Terrain", "const range2", 373.172, 67.92, 0.79, ["Puget", "Fuji"]),
    ("Terrain", "const range1", 1553.766, 72.28, 0.20, ["Puget", "Fuji"]),
    ("Terrain", "quad 5000", None, None, None, ["Puget", "Fuji"]),
    ("Terrain", "quad 20000", 283.578, 49.63, 2.49, ["Puget", "Fuji"]),
    ("Terrain", "quad 40000", 501.359, 53.86, 1.24, ["Puget", "Fuji"]),
    ("Eagle", "const range2", 257.765, 50.15, 2.10, ["coffee", "coffee, whole colour"]),
    ("Eagle", "const range1", 1155.125, 62.07, 0.53, ["coffee", "coffee, whole colour"]),
    ("Eagle", "quad 40000", 228.469, 47.67, 3.33, ["coffee", "coffee, whole colour"]),
    ("Eagle", "quad 80000", 476.062, 53.79, 2.10, ["coffee", "coffee, whole colour"]),
    ("Bunny", "const range2", 14.844, 39.74, 6.93, ["bunny"]),
    ("Bunny", "const range1", 71.500, 61.15, 1.12, ["bunny"]),
    ("Bunny", "quad 5000", 42.875, 39.71, 13.87, ["bunny"]),
    ("Bunny", "quad 10000", 62.719, 39.74, 10.72, ["bunny"]),
    ("Dragon", "const range2", 578.828, 42.70, 9.36, ["dragon"]),
    ("Dragon", "const range1", 2801.938, 63.36, 1.47, ["dragon"]),
    ("Dragon", "quad 20000", 2187.797, 42.55, 26.63, ["dragon"]),
    ("Dragon", "quad 40000", 2963.063, 42.70, 20.49, ["dragon"]),
]
# What a stand-in takes beside its parameters. By default the colour planes are half as large along each axis.
OPTIONS = {"coffee, whole colour": ["--chroma", "1"]}
# Table 2: model, parameters, by zoom the seconds of the discrete and of the real decoder.
TABLE_2 = [
    ("Lenna", "quad 10000", "photo", {50: (0.078, 0.062), 100: (0.125, 0.250), 200: (0.484, 0.969)}),
    ("Terrain", "quad 40000", "Puget", {50: (0.218, 0.344), 100: (0.562, 1.313), 200: (2.078, 4.945)}),
    ("Eagle", "quad 80000", "coffee", {50: (0.656, 0.687), 100: (2.047, 2.530), 200: (8.343, 9.794)}),
    ("Bunny", "quad 10000", "bunny", {50: (0.047, 0.016), 100: (0.343, 0.125), 200: (2.766, 0.984)}),
    ("Dragon", "quad 40000", "dragon", {50: (0.343, 0.125), 100: (2.219, 0.922), 200: (17.281, 7.125)}),
]
# Section 7 of the specification: PSNR and ratio of its prototype (F1: within 0.3 dB and 3 %).
PROTOTYPE = [
    ("photo", "quad 5000", 40.8, 3.92), ("photo", "quad 10000", 50.2, 2.05), ("photo", "const range2", 54.9, 1.25),
    ("Fuji", "quad 5000", 53.3, 16.1), ("Fuji", "quad 20000", 56.3, 4.62), ("Fuji", "quad 40000", 67.1, 2.45),
    ("Fuji", "const range2", np.inf, 1.95),
    ("Puget", "quad 5000", 34.9, 14.9), ("Puget", "quad 20000", 44.8, 3.78), ("Puget", "quad 40000", 52.4, 1.68),
    ("Puget", "quad 44000", 52.4, 1.68),  # as above, with more of the smaller maps
]  # fmt: skip


def said_by(command):
    """What a program prints as JSON, line by line."""
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}: {done.stderr.strip()}")
    return [json.loads(row) for row in done.stdout.splitlines()]


class Fractal:
    """The coders in a folder of their own; what was encoded once is kept."""

    def __init__(self, program):
        self.program = program
        self.solids = build("solids")
        self.folder = tempfile.TemporaryDirectory()
        self.sources = {}
        self.done = {}

    def file(self, name):
        return Path(self.folder.name, name.replace(" ", "_").replace(",", ""))

    def source(self, name):
        """The samples as bytes, and a file of them."""
        if name not in self.sources:
            if name in MESHES:
                _, mesh, side = MESHES[name]
                file = self.file(f"{name}.field")
                said_by([self.solids, "field", mesh, side, file])
                samples = np.fromfile(file, np.int8).reshape(side, side, side)
            else:
                file, samples = self.file(f"{name}.png"), PICTURES[name][1]()
                Image.fromarray(samples).save(file)
            self.sources[name] = samples, file
        return self.sources[name]

    def encoded(self, name, parameters):
        """Seconds, PSNR, ratio and the file."""
        key = name, parameters
        if key not in self.done:
            samples, source = self.source(name)
            file = self.file(f"{name} {parameters}.ifs")
            kind, value = parameters.replace("quad", "maps").replace("range", "").split()
            if name in MESHES:
                side, out = MESHES[name][2], self.file("out")
                [said] = said_by([self.solids, "encode", source, side, kind, value, file])
                said_by([self.solids, "decode", file, out])
                again = np.fromfile(out, np.int8).reshape(samples.shape)
            else:
                options = [f"--{kind}", value, *OPTIONS.get(name, []), "--search", "exact", "--json"]
                [said] = said_by([self.program, "fractal", "encode", source, file, *options])
                out = self.file("out.png")
                said_by([self.program, "fractal", "decode", file, out, "--json"])
                again = np.array(Image.open(out))
            size = file.stat().st_size
            if said["bytes"] != size:
                raise SystemExit(f"{file.name} has {size} bytes, {said['bytes']} were said")
            self.done[key] = said["seconds"], psnr(again, samples), samples.size / size, file
        return self.done[key]


def as_picture(samples):
    """Samples for coders of pictures: the layers of a volume side by side, eight a row."""
    if samples.ndim == 3 and samples.dtype == np.int8:
        n = len(samples)
        rows = (samples.astype(int) + 128).astype(np.uint8).reshape(n // 8, 8, n, n)
        return rows.transpose(0, 2, 1, 3).reshape(n // 8 * n, 8 * n)
    return samples


def decibels(value):
    return "-" if value is None else "exact" if np.isinf(value) else f"{value:.2f}"


def number(value, digits=2):
    return "-" if value is None else f"{value:.{digits}f}"


def table_1(fractal):
    yield line("published", "s", "dB", "ratio", "here", "s", "dB", "ratio", "JPEG XL at the dB", "JPEG 2000 at the dB", "JPEG XL lossless")
    yield line(*["---"] * 11)
    for model, parameters, seconds, quality, ratio, names in TABLE_1:
        for name in names:
            own_seconds, own, own_ratio, _ = fractal.encoded(name, parameters)
            picture = as_picture(fractal.source(name)[0])
            rivals = [number(picture.size / n) for n in (*at(picture, own), lossless_jpeg_xl(picture))]
            yield line(
                f"{model} {parameters}", number(seconds, 1), decibels(quality), number(ratio),
                f"{name} {parameters}", number(own_seconds), decibels(own), f"**{own_ratio:.2f}**", *rivals,
            )  # fmt: skip


def table_2(fractal, program):
    yield line("published", "zoom", "discrete", "real", "here", "discrete", "real", "real, seeded", "times faster")
    yield line(*["---"] * 9)
    for model, parameters, name, published in TABLE_2:
        file = fractal.encoded(name, parameters)[3]
        for row in said_by([program, file]):
            theirs = published[row["zoom"]]
            faster = " / ".join(f"{t / row[k]:.0f}" for t, k in zip(theirs, ("discrete", "real")))
            ms = [f"{row[k] * 1000:.1f} ms" for k in ("discrete", "real", "seeded")]
            yield line(f"{model} {parameters}", f"{row['zoom']} %", *(f"{t * 1000:.0f} ms" for t in theirs), name, *ms, faster)


def prototype(fractal):
    yield line("input", "maps", "prototype: dB", "ratio", "here: dB", "ratio", "F1")
    yield line(*["---"] * 7)
    for name, parameters, quality, ratio in PROTOTYPE:
        _, own, own_ratio, _ = fractal.encoded(name, parameters)
        missed = [what for what, ok in [("dB", own >= quality - 0.3), ("ratio", own_ratio >= 0.97 * ratio)] if not ok]
        mark = f"missed: {', '.join(missed)}" if missed else "reached"
        yield line(name, parameters, decibels(quality), ratio, decibels(own), f"{own_ratio:.2f}", mark)


def build(example):
    """Builds an example of codecs/; its path."""
    command = ["cargo", "build", "--release", "--example", example, "--message-format", "json"]
    lines = subprocess.run(command, cwd=ROOT / "codecs", check=True, stdout=subprocess.PIPE, text=True).stdout
    for message in map(json.loads, lines.splitlines()):
        if message.get("executable") and message["target"]["name"] == example:
            return message["executable"]
    raise SystemExit(f"cargo built no example '{example}'")


def document(program, only):
    fractal = Fractal(program)
    if "table1" in only:
        yield "\n### Table 1 of the paper: sizes and quality\n"
        yield from table_1(fractal)
    if "table2" in only:
        yield "\n### Table 2 of the paper: decoding\n"
        yield from table_2(fractal, build("fractal_times"))
    if "F1" in only:
        yield "\n### Beside the prototype of the specification\n"
        yield "Reached (acceptance F1): at most 0.3 dB and 3 % of the ratio below it.\n"
        yield from prototype(fractal)
    if "F7" in only:
        detail = build("detail")
        yield "\n### Detail beside the truth\n"
        yield from fractal_detail.table(detail)
        yield "\n### Detail of tiles without residual\n"
        yield from fractal_detail.without_residual(detail)


def into(path, text):
    """Replaces what stands between the marks of this tool."""
    begin, end = "<!-- tools/compare_fractal.py -->\n", "<!-- end of tools/compare_fractal.py -->\n"
    head, rest = Path(path).read_text().split(begin)
    Path(path).write_text(f"{head}{begin}{text}{end}{rest.split(end)[1]}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", help="a release build of terraquilt")
    parser.add_argument("--only", default="table1,table2,F1,F7", help="some of table1,table2,F1,F7")
    parser.add_argument("--into", help="a file with the marks of this tool; default: print")
    arguments = parser.parse_args()
    text = "\n".join(document(arguments.program, arguments.only.split(","))) + "\n"
    into(arguments.into, text) if arguments.into else print(text, end="")


if __name__ == "__main__":
    main()
