"""Shaded reliefs of Mount St. Helens with and without correction of seams, side by side: docs/pictures/seams_helens.png.

Needs numpy and rasterio, and the program built. Usage: python tools/seam_pictures.py PROGRAM OUT.png
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import rasterio

DATA = Path(__file__).parent.parent / "tests/data/st_helens"
BOX = "562100,5115680,562760,5116340"
STEP = 1.5


def shade(path):
    with rasterio.open(path) as d:
        z = d.read(1).astype(float)
    dy, dx = np.gradient(z, STEP)
    light = np.array([-0.5, 0.5, 0.7]) / np.linalg.norm([-0.5, 0.5, 0.7])
    lit = (-dx * light[0] + dy * light[1] + light[2]) / np.sqrt(1 + dx * dx + dy * dy)
    return (255 * np.clip(lit, 0, 1)).astype(np.uint8)


def main(program, out):
    run = lambda *a: subprocess.run([program, *a], check=True, stdout=subprocess.DEVNULL)
    with tempfile.TemporaryDirectory() as folder:
        db = f"{folder}/db"
        run("init", db, "--crs", "EPSG:26910", "--policy", "newest")
        for file, e, date in [
            ("survey_2000-09-25_native.tif", "2", "2000-09-25"),
            ("survey_2004-10-13_native.tif", "0.5", "2004-10-13"),
        ]:
            run("ingest", db, str(DATA / file), "--name", date, "--accuracy", e, "--date", date)
        rows = []
        for z in ["0", "5"]:
            row = []
            for seams in ["off", "all"]:
                tif = f"{folder}/{z}{seams}.tif"
                run("export", db, tif, "--error", z, "--seams", seams, "--bbox", BOX, "--step", str(STEP))
                row.append(shade(tif))
            rows.append(np.hstack([row[0], np.full((len(row[0]), 4), 255, np.uint8), row[1]]))
        picture = np.vstack([rows[0], np.full((4, rows[0].shape[1]), 255, np.uint8), rows[1]])
        h, w = picture.shape
        with rasterio.open(out, "w", driver="PNG", width=w, height=h, count=1, dtype="uint8") as d:
            d.write(picture, 1)


main(*sys.argv[1:])
