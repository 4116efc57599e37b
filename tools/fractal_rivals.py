"""Other coders of pictures at a wanted PSNR, and without loss. Each answer is decoded and measured."""

import imagecodecs as ic
import numpy as np


def psnr(a, b):
    """Decibels against 255; infinite where nothing differs."""
    wrong = np.mean((a.astype(float) - b.astype(float)) ** 2)
    return np.inf if wrong == 0 else 10 * np.log10(255**2 / wrong)


def jpeg_xl(picture, distance):
    data = ic.jpegxl_encode(picture, distance=distance, effort=7, numthreads=1)
    return data, ic.jpegxl_decode(data, numthreads=1)


def jpeg_2000(picture, decibels):
    data = ic.jpeg2k_encode(picture, decibels, reversible=False, codecformat="j2k", mct=picture.ndim == 3, numthreads=1)
    return data, ic.jpeg2k_decode(data, numthreads=1)


def lossless_jpeg_xl(picture):
    data = ic.jpegxl_encode(picture, lossless=True, effort=9, numthreads=1)
    exact("JPEG XL", ic.jpegxl_decode(data, numthreads=1), picture)
    return len(data)


def lossless_jpeg_2000(picture):
    data = ic.jpeg2k_encode(picture, reversible=True, codecformat="j2k", mct=picture.ndim == 3, numthreads=1)
    exact("JPEG 2000", ic.jpeg2k_decode(data, numthreads=1), picture)
    return len(data)


def exact(name, out, picture):
    if not np.array_equal(out, picture):
        raise SystemExit(f"{name} without loss is not the picture")


def least(coder, picture, wanted, low, high):
    """The least bytes that reach `wanted` decibels, and what they reach; `low` is a parameter of the finest quality. None: none does."""
    best = None
    for _ in range(14):
        middle = (low + high) / 2
        data, out = coder(picture, middle)
        reached = psnr(out, picture)
        if reached >= wanted:
            best = min(best or (len(data), reached), (len(data), reached))
            low = middle
        else:
            high = middle
    return best


def at(picture, wanted):
    """Bytes of JPEG XL and of JPEG 2000 at `wanted` decibels or more; without loss where that is smaller or nothing else gets there."""
    lossless = lossless_jpeg_xl(picture), lossless_jpeg_2000(picture)
    if np.isinf(wanted):
        return lossless
    lossy = least(jpeg_xl, picture, wanted, 0.01, 15), least(jpeg_2000, picture, wanted, wanted + 6, wanted - 6)
    return tuple(min(l[0], n) if l else n for l, n in zip(lossy, lossless))
