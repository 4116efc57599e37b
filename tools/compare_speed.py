#!/usr/bin/env python3
"""Compares terraquilt's speed with public tools on this machine, in this run, and prints one table.

    apt install gdal-bin
    pip install numpy rasterio pydelatin scipy
    cargo build --release --examples --bins
    python3 tools/compare_speed.py GRID.tif [--build target/release] [--sierra SRTM.tif] [--rounds 3] [--only 1,4,9] [--json OUT]

GRID is the 16385 x 16385 int16 grid of make_scale_dem.py. Rival and ours run alternately, `--rounds` times, and the medians are
compared; work that has no rival is counted or timed in process on one thread by `examples/speed`. Each row names what was
measured; docs/performance.md says how and what limits it. A database made for the run lies beside GRID and is removed. Takes about ten minutes and 1.5 GB of disk.
"""
import argparse, json, os, shutil, statistics, subprocess, sys, tempfile, time

COG = ["-of", "COG", "-co", "COMPRESS=ZSTD", "-co", "LEVEL=1", "-co", "PREDICTOR=2", "-co", "NUM_THREADS=ALL_CPUS"]
ROWS = []


def run(args, threads=None):
    """Wall seconds, peak resident bytes and output of a command; a failure ends the run."""
    env = dict(os.environ)
    if threads:
        env["RAYON_NUM_THREADS"] = str(threads)
    started = time.perf_counter()
    with tempfile.TemporaryFile("w+") as err:
        p = subprocess.Popen([str(a) for a in args], stdout=subprocess.PIPE, stderr=err, env=env)
        text = p.stdout.read().decode()
        _, status, usage = os.wait4(p.pid, 0)
        seconds = time.perf_counter() - started
        if status != 0:
            err.seek(0)
            sys.exit(f"{' '.join(map(str, args))}: status {status}\n{err.read()}")
    return seconds, usage.ru_maxrss * 1024, text


def example(a, name):
    return os.path.join(a.build, "examples", name)


def size_of(folder):
    return sum(os.path.getsize(os.path.join(r, f)) for r, _, files in os.walk(folder) for f in files)


def row(number, what, must, aim, value, shown, better="less"):
    """Adds a line to the table; must, aim and value are in one unit."""
    ok = (lambda limit: value <= limit) if better == "less" else (lambda limit: value >= limit)
    verdict = "aim" if ok(aim) else "met" if ok(must) else "MISSED"
    sign = "<=" if better == "less" else ">="
    line = {"row": number, "what": what, "measured": shown, "value": value, "must": f"{sign} {must:g}", "aim": f"{sign} {aim:g}", "verdict": verdict}
    ROWS.append(line)
    print(f"{str(number):>4}  {what:58}  {shown:44}  {line['must']:>10}  {line['aim']:>10}  {verdict}", flush=True)


def middle(values):
    return statistics.median(values)


def spread(values, unit, digits=1):
    return f"{middle(values):.{digits}f} {unit} ({min(values):.{digits}f} .. {max(values):.{digits}f})"


def ingest_rows(a, work):
    """Rows 1, 2, 3: the whole grid, durable and queryable, beside a COG of it. Leaves the database of the last round."""
    ours, theirs, peaks = [], [], []
    db, cog = os.path.join(work, "db"), os.path.join(work, "cog.tif")
    for _ in range(a.rounds):
        shutil.rmtree(db, ignore_errors=True)
        run([a.tq, "init", db, "--crs", a.crs])
        seconds, peak, _ = run([a.tq, "ingest", db, a.grid, "--accuracy", "1", "--json"])
        ours.append(seconds)
        peaks.append(peak)
        if os.path.exists(cog):
            os.remove(cog)
        theirs.append(run(["gdal_translate", "-q", *COG, a.grid, cog])[0])
    ratio = middle([o / t for o, t in zip(ours, theirs)])
    row(1, "ingest, durable and queryable / gdal_translate to COG", 1.5, 1.0, ratio, f"{ratio:.2f} x  ({spread(ours, 's')} / {spread(theirs, 's')})")
    share = size_of(db) / os.path.getsize(cog)
    row(2, "bytes on disk, all levels and index / COG with overviews", 1.0, 0.85, share, f"{share:.3f} x  ({size_of(db) / 1e6:.1f} / {os.path.getsize(cog) / 1e6:.1f} MB)")
    row(3, "peak resident memory of the ingest, GB", 1.0, 0.6, max(peaks) / 1e9, f"{max(peaks) / 1e9:.3f} GB")
    print("      fingerprint " + run([a.tq, "fingerprint", db])[2].strip())
    os.remove(cog)
    return db


def turned_survey(a, work):
    """A grid of 1025 x 1025 posts, 5 m apart, turned by 17 degrees, over the middle of GRID: its heights and half a metre more."""
    import numpy as np, rasterio
    from rasterio.transform import Affine
    from scipy.ndimage import map_coordinates

    n, step = 1025, 5.0
    with rasterio.open(a.grid) as f:
        t, rows, cols = f.transform, f.height, f.width
        centre = t * (cols / 2, rows / 2)
        place = Affine.translation(*centre) * Affine.rotation(17) * Affine.scale(step, -step) * Affine.translation(-n / 2, -n / 2)
        x, y = place * tuple(v + 0.5 for v in np.meshgrid(np.arange(n), np.arange(n)))
        c, r = ~t * (x, y)
        c0, r0 = int(c.min()) - 2, int(r.min()) - 2
        part = f.read(1, window=((r0, int(r.max()) + 3), (c0, int(c.max()) + 3))).astype(np.float32)
        z = map_coordinates(part, [r - 0.5 - r0, c - 0.5 - c0], order=1).astype(np.float32) + np.float32(0.5)
        path = os.path.join(work, "turned.tif")
        with rasterio.open(path, "w", driver="GTiff", width=n, height=n, count=1, dtype="float32", crs=f.crs, transform=place, tiled=True, blockxsize=256, blockysize=256, compress="deflate", predictor=3) as out:
            out.write(np.round(z, 2), 1)
    return path


def arrival_rows(a, work, db):
    """Rows 4, 5, 6: a turned survey arrives on the grid and leaves it; GDAL's way into a tiled mosaic beside it."""
    survey = turned_survey(a, work)
    copy = os.path.join(work, "arrivals")
    found = {}
    for policy in ("accuracy", "newest"):
        shutil.rmtree(copy, ignore_errors=True)
        if policy == "accuracy":
            shutil.copytree(db, copy)
        else:
            run([a.tq, "init", copy, "--crs", a.crs, "--policy", "newest"])
            run([a.tq, "ingest", copy, a.grid, "--accuracy", "1", "--date", "2020-01-01"])
        found[policy] = json.loads(run([a.speed, "arrival", copy, survey, 9])[2])
    shutil.rmtree(copy)
    of = lambda what, policy: found[policy][what]["median"]
    newest = f"newest {of('arrival_ms', 'newest'):.0f} ms"
    row(4, "a turned 1025^2 survey arrives: call to visible commit, ms", 300, 100, of("arrival_ms", "accuracy"), f"{of('arrival_ms', 'accuracy'):.0f} ms (least {found['accuracy']['arrival_ms']['least']:.0f}; {newest})")
    mosaic = os.path.join(work, "mosaic.tif")
    levels = ["2", "4", "8", "16", "32", "64"]
    run(["gdal_translate", "-q", "-co", "TILED=YES", "-co", "COMPRESS=ZSTD", "-co", "ZSTD_LEVEL=1", "-co", "PREDICTOR=2", "-co", "NUM_THREADS=ALL_CPUS", "-co", "BIGTIFF=YES", a.grid, mosaic])
    run(["gdaladdo", "-q", "-r", "average", "--config", "GDAL_NUM_THREADS", "ALL_CPUS", mosaic, *levels])
    theirs = []
    for _ in range(min(a.rounds, 2)):
        warp = run(["gdalwarp", "-q", "-r", "bilinear", "-multi", "-wo", "NUM_THREADS=ALL_CPUS", survey, mosaic])[0]
        add = run(["gdaladdo", "-q", "-r", "average", "--config", "GDAL_NUM_THREADS", "ALL_CPUS", mosaic, *levels])[0]
        theirs.append(warp + add)
    os.remove(mosaic)
    times = middle(theirs) * 1e3 / of("arrival_ms", "accuracy")
    row(5, "gdalwarp into the mosaic + gdaladdo / that", 30, 100, times, f"{times:.0f} x  ({spread(theirs, 's')})", "more")
    newest = f"newest {of('removal_ms', 'newest'):.0f} ms"
    row(6, "it is removed again: call to visible commit, ms", 300, 100, of("removal_ms", "accuracy"), f"{of('removal_ms', 'accuracy'):.0f} ms (least {found['accuracy']['removal_ms']['least']:.0f}; {newest})")


def query_rows(a, db):
    """Rows 7 to 10 and 18: `read` finds the patches and reads id, top and floor of each."""
    found = json.loads(run([example(a, "queries"), db, "--json"], threads=1)[2])
    by = {q["question"]: q for q in found["questions"]}

    def said(q):
        return f"{1e6 / q['read_us']:,.0f}/s ({q['patches']} patches; sorted copies {1e6 / q['select_us']:,.0f}/s)"

    row(7, "whole grid at 50 m, queries a second, one thread", 20e3, 50e3, 1e6 / by["uniform"]["read_us"], said(by["uniform"]), "more")
    row(8, "whole grid at 0 m, queries a second, one thread", 165, 500, 1e6 / by["finest"]["read_us"], said(by["finest"]), "more")
    c = by["camera"]
    row(9, "camera, 15 km, 1 px, us", 100, 30, c["read_us"], f"{c['read_us']:.1f} us ({c['patches']} patches; sorted copies {c['select_us']:.1f} us)")
    ratios = [by["uniform"]["ratio"], c["ratio"]]
    row(10, "rstar in memory / ours on disk, times, rows 7 and 9", 2, 5, min(ratios), f"{ratios[0]:.1f} x, {ratios[1]:.1f} x", "more")
    f = found["flight"]
    row(18, "camera flight at 60 Hz, share of one core, %", 5, 1, f["percent_of_a_core"], f"{f['percent_of_a_core']:.2f} % ({f['added']:.2f} patches come a frame)")


def evaluation_rows(a, db):
    """Rows 11, 12, 13: rates by the clock; the best of several calls."""
    found = json.loads(run([example(a, "evaluation"), db, "--json"], threads=1)[2])
    by = {(e["what"], e["tolerance_m"]): e for e in found}

    def add(number, what, must, aim, key, beside):
        e, other = by[(key, 0)], by[(beside, 0)]
        shown = f"{e['wall_mps']:.1f} M/s ({beside.split(', ')[-1]} {other['wall_mps']:.1f})"
        row(number, what, must, aim, e["wall_mps"], shown, "more")

    add(11, "grid of heights, bilinear, one core, million a second", 60, 200, "bilinear, grid at the posts", "bilinear, grid finer than the posts")
    add(12, "grid of heights, bicubic, one core, million a second", 20, 60, "bicubic, grid at the posts", "bicubic, grid finer than the posts")
    add(13, "10^6 random points in one call, one core, million/s", 5, 15, "bilinear, random points, as planes", "bilinear, random points, as structures")


def kernel_rows(a, db):
    """Rows 14 and 17."""
    d = json.loads(run([a.speed, "decode", db], threads=1)[2])["gigabytes_a_second"]["median"]
    row(14, "block decode from the mapped store, one core, GB/s", 1, 2, d, f"{d:.2f} GB/s", "more")
    p = json.loads(run([a.speed, "pyramid", db], threads=1)[2])["million_posts_a_second_all_levels"]["median"]
    row(17, "errors of all levels at every post, one core, M posts/s", 100, 200, p, f"{p:.0f} M posts/s", "more")


def mesh_rows(a, work):
    """Row 15: the crop of 1025 x 1025 posts, as a mesh within 5 m at every post, beside pydelatin on the same posts."""
    import numpy as np, rasterio
    from rasterio.transform import from_origin
    from rasterio.windows import Window
    from compare_delatin import delatin_within, error_at_posts, read_glb

    with rasterio.open(a.sierra) as f:
        posts = f.read(1, window=Window(1500, 600, 1025, 1025))
    crop, db, glb = (os.path.join(work, n) for n in ("crop.tif", "crop", "crop.glb"))
    step, east, north = 90.0, 300000.0, 4200000.0
    with rasterio.open(crop, "w", driver="GTiff", width=1025, height=1025, count=1, dtype=posts.dtype, crs="EPSG:32611", transform=from_origin(east, north, step, step)) as out:
        out.write(posts, 1)
    run([a.tq, "init", db, "--crs", "EPSG:32611"])
    run([a.tq, "ingest", db, crop, "--accuracy", "0"])
    run([a.tq, "export", db, glb, "--error", "5"])
    vertices, triangles, extras = read_glb(glb)
    o = extras["origin"]
    grid = np.stack([(vertices[:, 0] + o[0] - east - step / 2) / step, (north - step / 2 - vertices[:, 1] - o[1]) / step, vertices[:, 2] + o[2]], 1)
    error, _ = error_at_posts(grid, triangles, posts.astype(np.float32))
    # Every cell of the outermost ring lacks posts around it and is no part of the surface.
    inner = posts[1:-1, 1:-1].astype(np.float32)
    ours, theirs = [], []
    for _ in range(a.rounds):
        ours.append(json.loads(run([a.speed, "mesh", db, "5", "1"])[2])["seconds"]["median"])
        mesh, _, true, seconds = delatin_within(inner, max(5.0, error))
        theirs.append(seconds)
    one = json.loads(run([a.speed, "mesh", db, "5", "1"], threads=1)[2])["seconds"]["median"]
    share = len(triangles) / len(mesh.triangles)
    row("15a", "mesh within 5 m, triangles / pydelatin's", 1.0, 0.85, share, f"{share:.3f} x  ({len(triangles)} / {len(mesh.triangles)}; at the posts {error:.4f} and {true:.4f} m)")
    ratio = middle([o / t for o, t in zip(ours, theirs)])
    row("15b", "the same, time / pydelatin's", 1.0, 0.33, ratio, f"{ratio:.2f} x  ({spread(ours, 's', 2)} on all cores, {one:.2f} on one / {spread(theirs, 's', 2)})")


def growth_rows(a, db):
    """Row 16: tables of counted work and milliseconds."""
    print("  16  what a query, an arrival and a removal cost as the database grows")
    print(run([example(a, "growth"), "--counts", a.counts, "--db", db])[2])


PARTS = {
    (16,): growth_rows,
    (7, 8, 9, 10, 18): query_rows,
    (11, 12, 13): evaluation_rows,
    (14, 17): kernel_rows,
}


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("grid"); ap.add_argument("--crs", default="EPSG:32611")
    ap.add_argument("--build", default="target/release"); ap.add_argument("--rounds", type=int, default=3)
    ap.add_argument("--sierra", help="SRTM grid of the Sierra Nevada for row 15 (sierra_srtm3.tif of the shared data)")
    ap.add_argument("--counts", default="1,10,100", help="surveys over one place, for row 16")
    ap.add_argument("--only", help="rows, comma separated"); ap.add_argument("--json", help="the table as JSON, too")
    ap.add_argument("--db", help="a database of GRID, instead of one made in the run (rows 1 to 3 are left out)")
    a = ap.parse_args()
    a.tq, a.speed = os.path.join(a.build, "terraquilt"), example(a, "speed")
    wanted = {int(n) for n in a.only.split(",")} if a.only else set(range(1, 19))
    work = tempfile.mkdtemp(prefix="speed-", dir=os.path.dirname(os.path.abspath(a.grid)))
    load = os.getloadavg()
    print(f"load average at the start {load[0]:.1f}, {os.cpu_count()} cores")
    print(f"{'row':>4}  {'what':58}  {'measured':44}  {'must':>10}  {'aim':>10}")
    try:
        db = a.db or ingest_rows(a, work)
        if wanted & {4, 5, 6}:
            arrival_rows(a, work, db)
        if 15 in wanted and a.sierra:
            mesh_rows(a, work)
        elif 15 in wanted:
            print("  15  left out: give --sierra")
        for numbers, part in PARTS.items():
            if wanted & set(numbers):
                part(a, db)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    print(f"load average at the end {os.getloadavg()[0]:.1f}")
    if a.json:
        with open(a.json, "w") as f:
            json.dump(ROWS, f, indent=1)
    sys.exit(1 if any(r["verdict"] == "MISSED" for r in ROWS) else 0)


if __name__ == "__main__":
    main()
