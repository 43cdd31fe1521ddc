"""EXR files that other programs write and that hold no single flat picture."""

import numpy as np
import OpenEXR
import OpenImageIO as oiio


def deep(path):
    spec = oiio.ImageSpec(8, 6, 5, oiio.FLOAT)
    spec.channelnames, spec.deep = ("R", "G", "B", "A", "Z"), True
    samples = oiio.DeepData()
    samples.init(48, 5, [oiio.TypeDesc("float")] * 5, list(spec.channelnames))
    for pixel in range(48):
        samples.set_samples(pixel, 1 + pixel % 3)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec) and target.write_deep_image(samples) and target.close()


def parts(path):
    plane = np.ones((6, 8), np.float32)
    first = OpenEXR.Part({"name": "a"}, {name: plane for name in "RGBZ"})
    OpenEXR.File([first, OpenEXR.Part({"name": "b"}, {"Z": plane})]).write(str(path))


def mip_levels(path):
    picture = oiio.ImageBuf(oiio.ImageSpec(32, 32, 4, "float"))
    picture.specmod().channelnames = ("R", "G", "B", "Z")
    assert oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, picture, str(path))


def cropped(path):
    """A data window that does not cover the display window."""
    spec = oiio.ImageSpec(4, 3, 4, oiio.FLOAT)
    spec.channelnames, spec.x, spec.y, spec.full_width, spec.full_height = ("R", "G", "B", "Z"), 2, 1, 40, 20
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec) and target.write_image(np.ones((3, 4, 4), np.float32)) and target.close()


def halved_color(path):
    """Brightness for every pixel, color differences for every other; the header alone tells so."""
    plane = np.ones((8, 8), np.float32)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {name: plane for name in ("BY", "RY", "Y", "Z")}).write(str(path))
    data = path.read_bytes()
    for name in (b"BY\0", b"RY\0"):  # then its type, four bytes, and the steps across and down
        at = data.index(name) + len(name) + 8
        data = data[:at] + np.int32([2, 2]).tobytes() + data[at + 8 :]
    path.write_bytes(data)


def huge_windows(path):
    """One that claims 30000 x 30000 pixels of four channels and holds a few bytes."""
    plane = np.ones((2, 2), np.float32)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {name: plane for name in "RGBZ"}).write(str(path))
    data = path.read_bytes()
    path.write_bytes(data.replace(np.int32([0, 0, 1, 1]).tobytes(), np.int32([0, 0, 29_999, 29_999]).tobytes()))
