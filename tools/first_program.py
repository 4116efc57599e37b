#!/usr/bin/env python3
"""A first program against a Terraquilt server, as one would write it from proto/ with numpy.

Surveys of Mount St. Helens are streamed in while a view is kept open that is told of each; then the program asks for
heights, a profile and a raster, and fetches a mesh.

    pip install grpcio grpcio-tools numpy rasterio
    cargo build --release
    python tools/first_program.py                        # starts a server of its own on a free port of this machine
    python tools/first_program.py --server HOST:PORT     # uses one that runs (its database in EPSG:26910; token in $TERRAQUILT_TOKEN)
"""

import argparse
import os
import pathlib
import queue
import re
import subprocess
import sys
import tempfile
import threading
import zlib

import grpc
import numpy as np
import rasterio
from grpc_tools import protoc

ROOT = pathlib.Path(__file__).resolve().parent.parent
DATA = ROOT / "tests/data/st_helens"
SURVEYS = [  # file, name, day, stated accuracy in metres
    ("survey_2000-09-25_native.tif", "crater-2000", "2000-09-25", 2.0),
    ("survey_2004-10-04_native.tif", "dome-2004-10-04", "2004-10-04", 0.5),
    ("survey_2004-10-11_native.tif", "dome-2004-10-11", "2004-10-11", 0.5),
    ("survey_2004-10-13_native.tif", "dome-2004-10-13", "2004-10-13", 0.5),
    ("crater_2005-06-15_10m.tif", "crater-2005", "2005-06-15", 2.0),
]
DOME = (562_660.0, 5_116_000.0)
BLOCK_BYTES = 1 << 20


def stubs(folder):
    """Compiles proto/ into `folder` and imports it."""
    files = sorted(str(p) for p in (ROOT / "proto/terraquilt/v1").glob("*.proto"))
    done = protoc.main(["protoc", f"-I{ROOT / 'proto'}", f"--python_out={folder}", f"--grpc_python_out={folder}", *files])
    if done != 0:
        sys.exit("protoc refused proto/")
    sys.path.insert(0, str(folder))
    names = ["terrain", "catalog", "ingest", "query", "view", "heights", "export"]
    found = {}
    for n in names:
        found[n] = __import__(f"terraquilt.v1.{n}_pb2", fromlist=["x"])
        found[n + "_calls"] = __import__(f"terraquilt.v1.{n}_pb2_grpc", fromlist=["x"])
    return type("Stubs", (), found)


def own_server(program, folder):
    """Makes an empty database and serves it on a free port."""
    db = folder / "helens"
    subprocess.run([program, "init", db, "--crs", "EPSG:26910", "--policy", "newest"], check=True, stderr=subprocess.DEVNULL)
    server = subprocess.Popen([program, "serve", db, "--listen", "127.0.0.1:0"], stderr=subprocess.PIPE, text=True)
    for line in server.stderr:
        found = re.search(r"https?://([0-9.]+:[0-9]+)", line)
        if found:
            threading.Thread(target=lambda: [None for _ in server.stderr], daemon=True).start()
            return server, found.group(1)
    sys.exit("the server did not start")


def samples(pb, path, name, day, accuracy):
    """One survey as the messages of Ingest.Upload: a header, blocks of rows, the end."""
    with rasterio.open(path) as file:
        z, t, nodata = file.read(1), file.transform, file.nodata
    x, y = t * (0.5, 0.5)  # posts are the centres of pixels
    grid = pb.ingest.Grid(
        name=path.name, cols=z.shape[1], rows=z.shape[0], sample_type=pb.ingest.SAMPLE_TYPE_FLOAT32,
        x=x, y=y, col_dx=t.a, col_dy=t.d, row_dx=t.b, row_dy=t.e, nodata=nodata,
    )
    yield pb.ingest.UploadRequest(header=pb.ingest.UploadHeader(
        operation=f"first-program-{name}", name=name, accuracy_m=accuracy, date=day, crs="EPSG:26910", grids=[grid],
    ))
    z = np.ascontiguousarray(z, "<f4")
    at_once = max(1, BLOCK_BYTES // (z.shape[1] * 4))
    for row in range(0, z.shape[0], at_once):
        block = zlib.compress(z[row:row + at_once].tobytes())
        yield pb.ingest.UploadRequest(block=pb.ingest.SampleBlock(
            grid=0, row=row, rows=min(at_once, z.shape[0] - row), samples=block, crc32=zlib.crc32(block),
            packing=pb.ingest.SampleBlock.PACKING_ZLIB,
        ))
    yield pb.ingest.UploadRequest(finish=pb.ingest.UploadFinish())


class View:
    """Keeps the patches of a question, as the server tells of them."""

    def __init__(self, pb, call, error_m):
        self.pb, self.patches, self.asked, self.told = pb, {}, queue.Queue(), queue.Queue()
        question = pb.view.Question(number=1, tolerance=pb.terrain.Tolerance(error_m=error_m))
        self.asked.put(pb.view.ViewRequest(open=pb.view.OpenView(question=question)))
        self.stream = call.Hold(iter(self.asked.get, None))
        threading.Thread(target=self.listen, daemon=True).start()

    def listen(self):
        come = gone = size = 0
        try:
            for reply in self.stream:
                for handle in reply.removed:
                    del self.patches[handle]
                for patch in reply.added:
                    self.patches[patch.handle] = patch
                come, gone, size = come + len(reply.added), gone + len(reply.removed), size + reply.ByteSize()
                if not reply.more:
                    assert reply.patches == len(self.patches), "the server counts other patches"
                    self.told.put((reply.version, come, gone, size))
                    come = gone = size = 0
        except grpc.RpcError as e:
            if e.code() != grpc.StatusCode.CANCELLED:
                self.told.put(e)

    def until(self, version):
        """Waits for the difference that a version made."""
        while True:
            told = self.told.get(timeout=60)
            if isinstance(told, Exception):
                raise told
            if told[0] >= version:
                return told

    def close(self):
        self.asked.put(None)
        self.stream.cancel()


def main():
    args = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    args.add_argument("--server", help="HOST:PORT of a running server")
    args.add_argument("--program", default=ROOT / "target/release/terraquilt", help="the program, to start a server with")
    args.add_argument("--out", default="dome.glb", help="file for the mesh")
    args = args.parse_args()

    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        pb = stubs(folder)
        server, address = (None, args.server) if args.server else own_server(args.program, folder)
        try:
            talk(pb, address, args.out)
        finally:
            if server:
                server.terminate()
                server.wait(timeout=30)


def talk(pb, address, out):
    token = os.environ.get("TERRAQUILT_TOKEN")
    who = [("authorization", f"Bearer {token}")] if token else []

    class Authorized(grpc.UnaryUnaryClientInterceptor, grpc.UnaryStreamClientInterceptor,
                     grpc.StreamUnaryClientInterceptor, grpc.StreamStreamClientInterceptor):
        def go(self, proceed, details, request):
            return proceed(details._replace(metadata=list(details.metadata or []) + who), request)

        intercept_unary_unary = intercept_unary_stream = go
        intercept_stream_unary = intercept_stream_stream = go

    channel = grpc.intercept_channel(grpc.insecure_channel(address), Authorized())
    catalog = pb.catalog_calls.CatalogStub(channel)
    ingest = pb.ingest_calls.IngestStub(channel)
    heights = pb.heights_calls.HeightsStub(channel)
    crs = catalog.Info(pb.catalog.InfoRequest()).ground.crs
    if crs not in ("", "EPSG:26910"):
        sys.exit(f"{address}: its database is in {crs}, this program's surveys are in EPSG:26910; serve another, made by "
                 "`terraquilt init DB --crs EPSG:26910`")
    view = View(pb, pb.view_calls.ViewStub(channel), error_m=5.0)

    for file, name, day, accuracy in SURVEYS:
        for reply in ingest.Upload(samples(pb, DATA / file, name, day, accuracy)):
            last = reply
        version, come, gone, size = view.until(last.commit.version)
        print(f"{day}  {name:16} version {last.commit.version}: {last.commit.patches} patches; "
              f"the open view: {come} come, {gone} go, {size / 1024:.0f} KiB")
    view.close()

    listed = catalog.ListSurveys(pb.catalog.ListSurveysRequest())
    print(f"\nversion {listed.version}: " + ", ".join(s.name for s in listed.surveys))
    exact = pb.heights.HeightsHeader(tolerance=pb.terrain.Tolerance(error_m=0))

    points = np.array([DOME, (562_700.0, 5_115_950.0), (0.0, 0.0)], "<f8")
    for reply in heights.Ask(pb.heights.PointsRequest(header=exact, points=points.tobytes())):
        z, error = np.frombuffer(reply.z, "<f8"), np.frombuffer(reply.error_m, "<f8")
        for p, h, e in zip(points, z, error):
            print(f"height at {p[0]:.0f}, {p[1]:.0f}: " + ("no data" if np.isnan(h) else f"{h:.2f} m, error {e:.2f} m"))

    line = np.array([(562_000.0, 5_115_900.0), (563_200.0, 5_115_900.0)], "<f8")
    parts = list(heights.Profile(pb.heights.ProfileRequest(header=exact, line=line.tobytes())))
    z = np.concatenate([np.frombuffer(p.z, "<f8") for p in parts])
    print(f"profile across the dome: {len(z)} points, {np.nanmin(z):.1f} to {np.nanmax(z):.1f} m")

    raster = pb.heights.RasterRequest(header=exact, x=562_000, y=5_116_600, dx=10, dy=-10, cols=130, rows=130)
    z = np.concatenate([np.frombuffer(p.z, "<f8") for p in heights.Raster(raster)]).reshape(130, 130)
    print(f"raster of the dome: mean {np.nanmean(z):.2f} m, {np.isnan(z).sum()} posts without data")

    box = pb.terrain.Box(xmin=562_000, ymin=5_115_300, xmax=563_300, ymax=5_116_600)
    wanted = pb.export.FileRequest(
        format=pb.export.FileRequest.FORMAT_GLB, region=pb.terrain.Region(box=box),
        tolerance=pb.terrain.Tolerance(error_m=4),
    )
    with open(out, "wb") as file:
        for chunk in pb.export_calls.ExportStub(channel).File(wanted):
            file.write(chunk.data)
    print(f"{out}: {os.path.getsize(out)} bytes")


if __name__ == "__main__":
    try:
        main()
    except grpc.RpcError as e:
        sys.exit(f"{e.code().name}: {e.details()}")
