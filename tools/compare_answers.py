#!/usr/bin/env python3
"""Answers of the program beside those of other tools, on one survey at error 0.

    pip install numpy scipy contourpy rasterio
    python3 tools/compare_answers.py target/release/terraquilt GRID.tif --crs EPSG:26910

GRID.tif: a GeoTIFF without voids, north up, in a CRS in metres. Prints, for each answer, the largest difference; exits with 1
if one is above its tolerance. The same on a smooth surface made here shows what Horn's 3 x 3 differences (gdaldem) have to do
with the gradient of the bilinear surface.
"""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

import numpy as np
import rasterio
from contourpy import contour_generator
from rasterio.transform import from_origin
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

failed = []


def told(name, value, tolerance, unit):
    ok = value <= tolerance
    print(f"{name:66} {value:12.3g} {unit:4} (tolerance {tolerance:g}){'' if ok else '   FAILED'}")
    if not ok:
        failed.append(name)


def run(*args):
    done = subprocess.run([str(a) for a in args], check=True, capture_output=True, text=True)
    return done.stdout


def read(path):
    with rasterio.open(path) as f:
        return f.read(1).astype(np.float64), f.transform


def database(program, folder, name, file, crs):
    db = folder / name
    run(program, "init", db, "--crs", crs)
    run(program, "ingest", db, file, "--accuracy", "0", "--name", "one")
    return db


def lines_of(path):
    doc = json.loads(pathlib.Path(path).read_text())
    return [(f["properties"], np.array(f["geometry"]["coordinates"])) for f in doc["features"]]


def compare(program, folder, name, file, crs):
    print(f"\n{name}")
    db = database(program, folder, name, file, crs)
    z, t = read(file)
    step = t.a
    x0, y0 = t.c + step / 2, t.f - step / 2  # the first post
    post = lambda x, y: ((x - x0) / step, (y0 - y) / step)

    rows, cols = z.shape
    # A survey's lattice has its phase to 1e-4 of a step: so far may posts be moved, and heights with the slope.
    slack = 1e-6 + 1e-4 * (np.abs(np.diff(z, axis=0)).max() + np.abs(np.diff(z, axis=1)).max())

    # Profile: bilinear interpolation.
    a, b = (x0 + 3.3 * step, y0 - 4.1 * step), (x0 + (cols - 5.2) * step, y0 - (rows - 6.7) * step)
    out = json.loads(run(program, "profile", db, "--error", "0", "--json", "--step", step / 3, "--line",
                         f"{a[0]},{a[1]}", f"{b[0]},{b[1]}"))["points"]
    px, py = post(np.array([p["x"] for p in out]), np.array([p["y"] for p in out]))
    ours = np.array([p["z"] for p in out])
    told(f"profile, {len(out)} points, and scipy map_coordinates(order=1)",
         np.abs(ours - map_coordinates(z, [py, px], order=1)).max(), slack, "m")

    # Contours: the corners of the grid are the posts inside the core.
    interval = float(np.ptp(z)) / 23.7
    base = float(z.min()) + 0.123
    run(program, "contours", db, folder / "c.geojson", "--error", "0", "--interval", interval, "--base", base)
    ours = lines_of(folder / "c.geojson")
    core = z[1:-1, 1:-1]
    xs, ys = x0 + step * np.arange(1, cols - 1), y0 - step * np.arange(1, rows - 1)
    generator = contour_generator(xs, ys, core, name="serial", corner_mask=False)
    levels = sorted({p["elevation"] for p, _ in ours})
    vertex, count, length, theirs_length, closed, theirs_closed = 0.0, 0, 0.0, 0.0, 0, 0
    for level in levels:
        theirs = generator.lines(level)
        mine = [l for p, l in ours if p["elevation"] == level]
        p, q = np.concatenate(mine), np.concatenate(theirs)
        # Vertices of both are where the line meets the grid.
        d, _ = cKDTree(q).query(p)
        e, _ = cKDTree(p).query(q)
        vertex = max(vertex, d.max(), e.max())
        count += len(p)
        total = lambda ls: sum(np.hypot(*np.diff(l, axis=0).T).sum() for l in ls)
        length, theirs_length = length + total(mine), theirs_length + total(theirs)
        closed += sum(bool((l[0] == l[-1]).all()) for l in mine)
        theirs_closed += sum(bool((l[0] == l[-1]).all()) for l in theirs)
    told(f"contours, {len(levels)} levels, {count} vertices: nearest vertex of contourpy", vertex, 0.002, "m")
    told("  length of all lines, relative (saddles are told apart differently)",
         abs(length / theirs_length - 1), 1e-3, "")
    print(f"  lines {len(ours)} (closed {closed}), contourpy closed {theirs_closed}")

    # Gradient at the centres of cells: the mean difference of the four posts around.
    east = ((z[:, 1:] - z[:, :-1])[1:] + (z[:, 1:] - z[:, :-1])[:-1]) / 2 / step
    north = ((z[:-1] - z[1:])[:, 1:] + (z[:-1] - z[1:])[:, :-1]) / 2 / step
    east, north = east[1:-1, 1:-1], north[1:-1, 1:-1]
    slope = np.degrees(np.arctan(np.hypot(east, north)))
    aspect = np.degrees(np.arctan2(-east, -north)) % 360
    az, alt = np.radians(315), np.radians(45)
    light = (np.sin(alt) - east * np.sin(az) * np.cos(alt) - north * np.cos(az) * np.cos(alt)) / np.sqrt(1 + east**2 + north**2)
    shade = 255 * np.maximum(light, 0)
    found = {}
    for command in ["slope", "aspect", "hillshade"]:
        run(program, command, db, folder / f"{command}.tif", "--error", "0")
        found[command], _ = read(folder / f"{command}.tif")
    told("slope and numpy (bilinear, centres of cells)", np.abs(found["slope"] - slope).max(), 1e-4, "deg")
    sloping = np.hypot(east, north) > 1e-3
    turn = np.abs(found["aspect"] - aspect)
    told("aspect and numpy, where steeper than 0.001", np.minimum(turn, 360 - turn)[sloping].max(), 0.01, "deg")
    told("hillshade and numpy, of 255", np.abs(found["hillshade"] - shade).max(), 1e-3, "")

    # Horn's differences at the posts, as gdaldem takes them; brought to the centres by the mean of four posts.
    he = ((z[:-2, 2:] + 2 * z[1:-1, 2:] + z[2:, 2:]) - (z[:-2, :-2] + 2 * z[1:-1, :-2] + z[2:, :-2])) / (8 * step)
    hn = ((z[:-2, :-2] + 2 * z[:-2, 1:-1] + z[:-2, 2:]) - (z[2:, :-2] + 2 * z[2:, 1:-1] + z[2:, 2:])) / (8 * step)
    four = lambda v: (v[1:, 1:] + v[:-1, 1:] + v[1:, :-1] + v[:-1, :-1]) / 4
    horn = np.degrees(np.arctan(np.hypot(four(he), four(hn))))
    d = np.abs(found["slope"] - horn)
    print(f"  slope beside Horn 3 x 3 at the centres: median {np.median(d):.3g}, p99 {np.quantile(d, 0.99):.3g}, largest {d.max():.3g} deg")

    # Statistics and volume.
    centre = four(z)[1:-1, 1:-1]
    s = json.loads(run(program, "statistics", db, "--error", "0", "--json"))
    told("statistics: mean and numpy", abs(s["mean_m"] - centre.mean()), 1e-6, "m")
    told("statistics: standard deviation", abs(s["std_m"] - centre.std()), 1e-6, "m")
    told("statistics: lowest and highest post", max(abs(s["min_m"] - core.min()), abs(s["max_m"] - core.max())), 1e-6, "m")
    rng = np.random.default_rng(7)
    other = (z + rng.normal(0, 3, z.shape) + 1).astype(np.float32)
    second = folder / f"{name}-after.tif"
    with rasterio.open(file) as f:
        profile = {**f.profile, "dtype": "float32", "nodata": None}
    with rasterio.open(second, "w", **profile) as f:
        f.write(other, 1)
    run(program, "ingest", db, second, "--accuracy", "0", "--name", "two")
    v = json.loads(run(program, "volume", db, "--from-surveys", "one", "--to-surveys", "two", "--error", "0", "--json"))
    d = four(other.astype(np.float64) - z)[1:-1, 1:-1] * step * step
    told("volume: net and numpy sum, relative", abs(v["net_m3"] / d.sum() - 1), 1e-9, "")
    told("volume: fill and cut, relative",
         max(abs(v["fill_m3"] / d.clip(0).sum() - 1), abs(v["cut_m3"] / (-d).clip(0).sum() - 1)), 1e-9, "")
    k = run(program, "contradictions", db, "--json")
    k = json.loads(k)[0]
    four_all = four(other.astype(np.float64) - z)
    told("contradictions: mean and standard deviation of all cells",
         max(abs(abs(k["mean_m"]) - abs(four_all.mean())), abs(k["std_m"] - four_all.std())), 1e-6, "m")


def main():
    p = argparse.ArgumentParser()
    p.add_argument("program")
    p.add_argument("grid")
    p.add_argument("--crs", required=True)
    a = p.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        compare(a.program, folder, "survey", a.grid, a.crs)
        # Hills of 400 to 1100 m wavelength under posts of 5 m.
        y, x = np.mgrid[0:400, 0:500] * 5.0
        z = 600 + 90 * np.sin(x / 110) * np.cos(y / 90) + 40 * np.sin((x + 2 * y) / 170) + 20 * np.cos((x - y) / 65)
        smooth = folder / "smooth.tif"
        with rasterio.open(smooth, "w", driver="GTiff", width=500, height=400, count=1, dtype="float32", crs=a.crs,
                           transform=from_origin(500000, 5100000, 5, 5)) as f:
            f.write(z.astype(np.float32), 1)
        compare(a.program, folder, "smooth", smooth, a.crs)
    sys.exit(1 if failed else 0)


main()
