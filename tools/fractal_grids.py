"""The stand-ins of the paper's models, as pictures of 8 bits, and the grids on which synthetic detail is judged.

The paper's own pictures are not at hand: a photograph of the same size stands for Lenna, a DEM of the same size for Terrain, a colour
photograph of nearly the same size for Eagle, Stanford's bunny for the bunny and Stanford's dragon for the Phlegmatic dragon.
"""

import numpy as np
from gtb_grids import DATA, ELEVATION
from PIL import Image


def picture(name):
    return np.array(Image.open(DATA / "images" / name))


def box(z):
    """2 x 2 means; an odd row or column at an end is left out."""
    z = z[: len(z) // 2 * 2, : z.shape[1] // 2 * 2]
    return (z[::2, ::2] + z[1::2, ::2] + z[::2, 1::2] + z[1::2, 1::2]) / 4


def photograph():
    return np.rint(box(picture("camera.png").astype(float))).astype(np.uint8)


def fuji():
    rgb = np.array(Image.open(DATA / "codec/fuji.png").convert("RGB")).astype(float)
    z = 65536 * rgb[..., 0] + 256 * rgb[..., 1] + rgb[..., 2]
    return np.rint((z - z.min()) * 255 / (z.max() - z.min())).astype(np.uint8)


# Name: what it is, and how it is read.
PICTURES = {
    "photo": ("camera, 256²", photograph),
    "Puget": ("DEM, 8 bits, 512²", lambda: picture("puget_dem_512_8bit.png")),
    "Fuji": ("DEM, 8 bits, 512²", fuji),
    "coffee": ("RGB, 600 x 400", lambda: picture("coffee.png")),
    "coffee, whole colour": ("the same", lambda: picture("coffee.png")),
}
# Name: what it is, its file, and samples a side.
MESHES = {
    "bunny": ("distance field, 64³", DATA / "mesh/stanford_bunny.ply", 64),
    "dragon": ("distance field, 128³", DATA / "mesh/stanford_dragon_res3.ply", 128),
}
# Grids of terrain by their part in the making of synthetic detail: its form was found on the first, its two numbers (how much of the
# extrapolated power, how smooth) were settled with a look at the second, the third had no part.
PARTS = {
    "form": ["Fuji", "San Gabriel", "Elk Mts"],
    "numbers": ["White Mts", "Sierra", "Oso", "Slovenia", "Tien Shan", "Himalaya"],
    "none": ["fault", "Rainier", "Cape Flattery", "Spearfish", "San Francisco", "Aitkin"],
}


def terrain(name):
    """Whole units as float64, the sides multiples of 16 and at most 512: two halvings leave whole ranges of 4."""
    z = ELEVATION[name][1]().astype(float)
    rows, cols = (min(n // 16 * 16, 512) for n in z.shape)
    return z[:rows, :cols]
