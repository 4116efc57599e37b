#!/usr/bin/env python3
"""Compares a GLB mesh with what pydelatin makes of the same posts at the same true error.

    pip install pydelatin rasterio numpy
    compare_delatin.py FILE.tif MESH.glb [--window COL,ROW,COLS,ROWS] [--error M] [--posts X0,Y0,STEP]
                       [--command "terraquilt export ..."]

pydelatin runs with the largest max_error whose mesh is at most --error (default: asset.extras.mesh_error_m or
error_m of the GLB) from every post, measured here and not by it. With --posts (local coordinates of the
north-west post and the distance of posts, metres; default: from the GeoTIFF and asset.extras.origin, where the
GeoTIFF is in metres) the GLB is measured at every post in the same way, and its own largest error is the one
that pydelatin must meet. With --command, that command writes the GLB and is timed. With --surface N both
meshes are also measured on a lattice N times finer than the posts, against the bilinear surface through them.
"""

import argparse
import json
import shlex
import struct
import subprocess
import time

import numpy as np
import rasterio
from pydelatin import Delatin
from rasterio.windows import Window


def read_glb(path):
    """Positions as (x east, y north, z up), triangles, asset.extras."""
    data = open(path, "rb").read()
    (length,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + length])
    extras = document["asset"].get("extras", {})
    if "meshes" not in document:
        return np.zeros((0, 3)), np.zeros((0, 3), int), extras
    binary = data[28 + length :]
    primitive = document["meshes"][0]["primitives"][0]

    def array(index, kind, width):
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        return np.frombuffer(binary, kind, accessor["count"] * width, view.get("byteOffset", 0)).reshape(-1, width)

    kind = {5123: "<u2", 5125: "<u4"}[document["accessors"][primitive["indices"]]["componentType"]]
    gltf = array(primitive["attributes"]["POSITION"], "<f4", 3).astype(float)
    triangles = array(primitive["indices"], kind, 1).reshape(-1, 3).astype(np.int64)
    return np.stack([gltf[:, 0], -gltf[:, 2], gltf[:, 1]], 1), triangles, extras


def error_at_posts(vertices, triangles, posts, chunk=8_000_000):
    """Largest distance at the posts; vertices as (column, row, z). Also how many posts no triangle covers."""
    rows, cols = posts.shape
    covered = np.zeros(posts.shape, bool)
    corner = vertices[triangles]
    low = np.ceil(corner[:, :, :2].min(1) - 1e-6).astype(np.int64).clip(0)
    high = np.floor(corner[:, :, :2].max(1) + 1e-6).astype(np.int64)
    high = np.minimum(high, [cols - 1, rows - 1])
    size = (high - low + 1).clip(0)
    count = size.prod(1)
    worst, start, ends = 0.0, 0, np.cumsum(count)
    while start < len(triangles):
        base = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, base + chunk)))
        part = slice(start, stop)
        which = np.repeat(np.arange(start, stop), count[part])
        offset = np.arange(len(which)) - np.repeat(ends[part] - count[part] - base, count[part])
        c = low[which, 0] + offset % np.maximum(size[which, 0], 1)
        r = low[which, 1] + offset // np.maximum(size[which, 0], 1)
        a, b, d = corner[which, 0], corner[which, 1], corner[which, 2]
        area = (b[:, 0] - a[:, 0]) * (d[:, 1] - a[:, 1]) - (d[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
        area = np.where(area == 0, np.nan, area)
        v = ((c - a[:, 0]) * (d[:, 1] - a[:, 1]) - (d[:, 0] - a[:, 0]) * (r - a[:, 1])) / area
        w = ((b[:, 0] - a[:, 0]) * (r - a[:, 1]) - (c - a[:, 0]) * (b[:, 1] - a[:, 1])) / area
        inside = (v >= -1e-9) & (w >= -1e-9) & (v + w <= 1 + 1e-9)
        z = a[:, 2] + v * (b[:, 2] - a[:, 2]) + w * (d[:, 2] - a[:, 2])
        error = np.abs(z - posts[r, c])[inside]
        covered[r[inside], c[inside]] = True
        if len(error):
            worst = max(worst, float(np.nanmax(error)))
        start = stop
    return worst, int((~covered).sum())


def delatin_within(posts, error):
    """The coarsest mesh of pydelatin truly within `error`, its vertices on the grid, error and seconds of one run."""
    bound = error
    while True:
        start = time.perf_counter()
        mesh = Delatin(posts, max_error=bound)
        seconds = time.perf_counter() - start
        vertices = mesh.vertices.astype(float)
        vertices[:, 1] = posts.shape[0] - 1 - vertices[:, 1]  # its rows count from the south
        true, missing = error_at_posts(vertices, mesh.triangles.astype(np.int64), posts)
        if true <= error * (1 + 1e-6):
            return mesh, vertices, true, seconds
        bound *= min(0.999, error / true)
        if bound < error / 10 or missing:
            raise SystemExit(f"pydelatin is {true} m off at {bound} m, {missing} posts not covered")


def finer(posts, n):
    """The bilinear surface through the posts on a lattice n times finer."""

    def along_rows(a):
        t = np.arange((a.shape[0] - 1) * n + 1) / n
        i = np.minimum(t.astype(int), a.shape[0] - 2)
        t = (t - i)[:, None]
        return a[i] * (1 - t) + a[i + 1] * t

    return along_rows(along_rows(posts.astype(float)).T).T


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tif")
    parser.add_argument("glb")
    parser.add_argument("--window", help="COL,ROW,COLS,ROWS of the crop; default: everything")
    parser.add_argument("--error", type=float, help="metres; default: what the GLB says")
    parser.add_argument("--posts", help="X0,Y0,STEP: local coordinates of the north-west post, metres")
    parser.add_argument("--surface", type=int, metavar="N", help="also measure between the posts")
    parser.add_argument("--command", help="a command that writes the GLB, to be timed")
    arguments = parser.parse_args()

    seconds = None
    if arguments.command:
        start = time.perf_counter()
        subprocess.run(shlex.split(arguments.command), check=True, stdout=subprocess.DEVNULL)
        seconds = time.perf_counter() - start
    with rasterio.open(arguments.tif) as source:
        window = Window(*map(int, arguments.window.split(","))) if arguments.window else None
        posts = source.read(1, window=window).astype(np.float32)
        transform = source.window_transform(window) if window else source.transform
        metric = source.crs is not None and source.crs.is_projected
    vertices, triangles, extras = read_glb(arguments.glb)
    error = arguments.error or extras.get("mesh_error_m", extras.get("error_m"))
    print(f"posts: {posts.shape[1]} x {posts.shape[0]}")

    placed = None
    if arguments.posts:
        placed = tuple(map(float, arguments.posts.split(",")))
        origin_up = 0.0
    elif metric and "origin" in extras:
        east, north, origin_up = extras["origin"]
        x, y = transform * (0.5, 0.5)
        placed = (x - east, y - north, transform.a)
    if placed:
        x0, y0, step = placed
        grid = np.stack([(vertices[:, 0] - x0) / step, (y0 - vertices[:, 1]) / step, vertices[:, 2] + origin_up], 1)
        measured, missing = error_at_posts(grid, triangles, posts)
        print(f"ours:      {len(triangles)} triangles, {measured:.6g} m at the posts, {missing} posts not covered", end="")
        error = measured if not arguments.error else error
    else:
        print(f"ours:      {len(triangles)} triangles, {error:.6g} m by its own account", end="")
    print(f", {seconds:.2f} s with reading and writing" if seconds is not None else "")

    mesh, theirs, true, seconds = delatin_within(posts, error)
    print(f"pydelatin: {len(mesh.triangles)} triangles, {true:.6g} m at the posts, {seconds:.2f} s")
    if arguments.surface and placed:
        surface, n = finer(posts, arguments.surface), arguments.surface
        for name, corners, faces in (("ours", grid, triangles), ("pydelatin", theirs, mesh.triangles.astype(np.int64))):
            between, _ = error_at_posts(corners * [n, n, 1], faces, surface)
            print(f"{name + ':':10} {between:.6g} m between the posts as well")
    print(f"ratio:     {len(triangles) / len(mesh.triangles):.4f} triangles")


if __name__ == "__main__":
    main()
