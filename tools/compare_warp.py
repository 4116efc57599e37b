#!/usr/bin/env python3
"""Resampled surveys beside gdalwarp: how far the product's posts are from `gdalwarp -r cubic` on the same posts, and how far
GDAL's own cubic and lanczos are from each other there.

    python3 tools/compare_warp.py target/release/terraquilt ../shared/data

Needs numpy and rasterio (pip) and gdalwarp (Debian: gdal-bin). gdalwarp runs with -et 0 -wo SAMPLE_GRID=NO (exact places); the
outermost three posts and those within three of a void are left out, where rules for borders differ.
"""
import json
import os
import subprocess
import sys
import tempfile
import zipfile

import numpy as np
import rasterio

program, data = sys.argv[1:3]


def run(*args):
    return subprocess.run([str(a) for a in args], check=True, capture_output=True, text=True).stdout


def away_from_voids(ok, by=3):
    grown = ~ok
    for _ in range(by):
        g = grown.copy()
        g[1:] |= grown[:-1]
        g[:-1] |= grown[1:]
        g[:, 1:] |= grown[:, :-1]
        g[:, :-1] |= grown[:, 1:]
        grown = g
    inner = ~grown
    inner[:by] = inner[-by:] = False
    inner[:, :by] = inner[:, -by:] = False
    return inner


def compare(folder, file, system, said=()):
    name = os.path.basename(file).split(".")[0]
    db = os.path.join(folder, name)
    run(program, "init", db, "--crs", system)
    run(program, "ingest", db, file, "--name", name, "--accuracy", "1", *said)
    row = json.loads(run(program, "surveys", db, "--json"))[0]
    (sx, sy), (x0, y0, x1, y1) = row["step"], row["bounds"]
    # A regular grid of the survey's posts, as pixel centres.
    cols, rows = round((x1 - x0) / sx) + 1, round((y1 - y0) / sy) + 1
    box = (x0 - sx / 2, y1 + sy / 2 - rows * sy, x0 - sx / 2 + cols * sx, y1 + sy / 2)
    ours = os.path.join(folder, "ours.tif")
    run(program, "export", db, ours, "--error", "0", "--step", f"{sx},{sy}", "--bbox", ",".join(map(repr, box)))
    grids = [rasterio.open(ours).read(1).astype(float)]
    for kind in ("cubic", "lanczos"):
        out = os.path.join(folder, kind + ".tif")
        run("gdalwarp", "-q", "-overwrite", "-r", kind, "-et", "0", "-wo", "SAMPLE_GRID=NO", "-t_srs", system, "-ot", "Float64",
            "-te", *map(repr, box), "-ts", cols, rows, "-dstnodata", "nan", file, out)
        grids.append(rasterio.open(out).read(1))
    o, c, l = (g[:rows, :cols] for g in grids)
    ok = away_from_voids(~(np.isnan(o) | np.isnan(c) | np.isnan(l)))
    table = []
    for d in (np.abs(o - c)[ok], np.abs(l - c)[ok]):
        table += [d.mean(), np.percentile(d, 99), d.max()]
    print(f"{name:28} {sx:>10} m {ok.sum():>9} " + " ".join(f"{v:8.4f}" for v in table), flush=True)
    return table[0] <= table[3] and table[1] <= table[4] and table[2] <= table[5]


print(f"{'survey':28} {'posts':>12} {'compared':>9} {'ours against cubic: mean p99 max':>26} {'lanczos against cubic':>26}")
good = True
with tempfile.TemporaryDirectory() as folder:
    for tile in ("N00E010", "N00E011"):
        zipfile.ZipFile(f"{data}/overlap/gabon/{tile}.hgt.zip").extractall(folder)
        good &= compare(folder, f"{folder}/{tile}.hgt", "EPSG:32632")
    for k in ("k01_base_x4", "k02_mid_x2", "k03_native_a", "k04_native_b", "k07_halfcell_shift", "k08_later_biased",
              "k11_webmercator"):
        good &= compare(folder, f"{data}/kit/{k}.tif", "EPSG:32611")
    good &= compare(folder, f"{data}/kit/k10_albers_30m_real.tif", "EPSG:32611", ("--crs", "ESRI:102003"))
print("nowhere further from cubic than lanczos is" if good else "FURTHER FROM CUBIC THAN LANCZOS IS")
sys.exit(not good)
