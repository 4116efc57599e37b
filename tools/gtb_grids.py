"""The grids of the tables of GTB, as integers of a unit, cut from the shared data; and the example program `raw` of codecs/.

A crop is the one that the specification names, or the window of greatest deviation on a raster of 128 posts that has no voids.
"""

import json
import struct
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import rasterio
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT.parent / "shared/data"
VOID = -(2**31)


def band(name):
    """Heights as float64, NaN where the file has none."""
    path = DATA / name
    with rasterio.open(f"/vsizip/{path}/{path.stem}" if path.suffix == ".zip" else path) as source:
        z = source.read(1).astype(float)
        if source.nodata is not None:
            z[z == np.float64(source.nodata)] = np.nan
    z[~(np.abs(z) < 12000)] = np.nan
    return z


def windows(z, side):
    for y in range(0, z.shape[0] - side + 1, 128):
        for x in range(0, z.shape[1] - side + 1, 128):
            yield z[y : y + side, x : x + side]


def steepest(name, unit, side=513):
    """The window of greatest deviation without voids, in units."""
    whole = [w for w in windows(band(name), side) if not np.isnan(w).any()]
    return np.rint(max(whole, key=np.std) / unit).astype(np.int32)


def fuji():
    rgb = np.array(Image.open(DATA / "codec/fuji.png").convert("RGB")).astype(np.int64)
    z = -10000 + 0.1 * (65536 * rgb[..., 0] + 256 * rgb[..., 1] + rgb[..., 2])
    return np.pad(np.rint(z).astype(np.int32), ((0, 1), (0, 1)), mode="edge")


def white():
    tile = np.fromfile(DATA / "codec/N44W072.hgt", ">i2").reshape(1201, 1201)
    return tile[:1025, :1025].astype(np.int32)


def san_gabriel():
    return band("dem/bigtujunga_srtm30m_utm11.tif")[60:573, 300:813].astype(np.int32)


def everest_voids():
    """The window of Everest whose share of voids is nearest to the specification's 15.8 %."""
    z = min(windows(band("dem/everest_srtm3.tif"), 513), key=lambda w: abs(np.isnan(w).mean() - 0.158))
    return np.where(np.isnan(z), VOID, z).astype(np.int32)


# Name: what it is, the unit, and how it is read. Elevation of the ground; some are small because their files are.
ELEVATION = {
    "Fuji": ("web tile 1 m", fuji),
    "San Gabriel": ("SRTM 30 m", san_gabriel),
    "White Mts": ("SRTM 90 m", white),
    "fault": ("NED 90 m", lambda: band("dem/jacksboro_fault_3s.tif")[:257, :257].astype(np.int32)),
    "Elk Mts": ("3DEP 10 m, unit 0.1 m", lambda: steepest("dem/colorado_3dep_10m.tif", 0.1)),
    "Slovenia": ("lidar DTM 1 m, unit 1 cm", lambda: steepest("dem/slovenia_lidar_dtm1m.tif", 0.01)),
    "Oso": ("lidar DTM 1.8 m, unit 1 cm", lambda: steepest("dem/oso_landslide_lidar_6ft.tif", 0.01)),
    "Sierra": ("SRTM 90 m", lambda: steepest("dem/sierra_srtm3.tif", 1)),
    "Rainier": ("SRTM 90 m", lambda: steepest("dem/rainier_srtm3.tif", 1, 257)),
    "Cape Flattery": ("SRTM 30 m", lambda: steepest("dem/N48W125.hgt.zip", 1)),
    "Spearfish": ("USGS DEM 30 m", lambda: steepest("dem/spearfish_30m_nad27.tif", 1, 257)),
    "San Francisco": ("USGS 30 m, unit 0.1 m", lambda: steepest("dem/sanfrancisco_usgs_1s.tif", 0.1, 257)),
    "Aitkin": ("lidar DTM 1 m, unit 1 cm", lambda: steepest("dem/minnesota_lidar_dem_1m.tif", 0.01, 257)),
    "Tien Shan": ("GEBCO 450 m", lambda: steepest("dem/gebco_tienshan_15s.tif", 1)),
    "Himalaya": ("GLOBE 1 km", lambda: steepest("dem/globe_asia_30s.tif", 1)),
}
SURFACE = {
    "NRW": ("lidar DSM 1 m, unit 1 cm", lambda: steepest("dem/nrw_dom1_1m.tif", 0.01)),
    "NRW, 10 cm": ("the same, unit 10 cm", lambda: steepest("dem/nrw_dom1_1m.tif", 0.1)),
}


def build_raw():
    """Builds codecs/examples/raw.rs; its path."""
    command = ["cargo", "build", "--release", "--example", "raw", "--message-format", "json"]
    lines = subprocess.run(command, cwd=ROOT / "codecs", check=True, stdout=subprocess.PIPE, text=True).stdout
    for message in map(json.loads, lines.splitlines()):
        if message.get("executable") and message["target"]["name"] == "raw":
            return message["executable"]
    raise SystemExit("cargo built no example 'raw'")


class Refused(Exception):
    """What the program says that it cannot do."""


class Raw:
    """The codec on raw grids, in a folder of its own."""

    def __init__(self, program):
        self.program = program
        self.folder = tempfile.TemporaryDirectory()
        self.file = f"{self.folder.name}/stream.gtb"

    def run(self, *args):
        done = subprocess.run([self.program, *map(str, args)], capture_output=True, text=True)
        if done.returncode:
            raise Refused(done.stderr.strip())
        return json.loads(done.stdout)

    def encode(self, z, profile, layers):
        """What the program says of the stream: bytes, error_max, seconds, ends [[layer, bytes, bound], ...]."""
        grid = f"{self.folder.name}/grid"
        Path(grid).write_bytes(struct.pack("<II", z.shape[1], z.shape[0]) + z.astype("<i4").tobytes())
        return self.run("encode", profile, ",".join(map(str, layers)), grid, self.file)

    def decode(self, cut=None):
        """Heights (NaN: void) and what the program says: bytes_used, error_bound, complete, seconds."""
        out = f"{self.folder.name}/out"
        said = self.run("decode", self.file, out, *([] if cut is None else [cut]))
        data = Path(out).read_bytes()
        cols, rows = struct.unpack("<II", data[:8])
        return np.frombuffer(data[8:], "<f8").reshape(rows, cols), said
