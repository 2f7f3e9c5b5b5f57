"""Describe the particles of the belt papers: shape and size."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Bulk:
    """One bulk material of particles that lie on their largest face.

    Parameters
    ----------
    outline_mm
        Half length, half width and corner radius, from above.
    rest_mm
        Height of the centre above the belt.
    """

    outline_mm: tuple[float, float, float]
    rest_mm: float


# Spheres of 5 mm, boxes of 6 x 5 x 2 mm, cylinders of 9 mm by a diameter of 3 mm.
BULKS = {
    "spheres": Bulk(outline_mm=(2.5, 2.5, 2.5), rest_mm=2.5),
    "cuboids": Bulk(outline_mm=(3.0, 2.5, 0.0), rest_mm=1.0),
    "cylinders": Bulk(outline_mm=(4.5, 1.5, 0.0), rest_mm=1.5),
}
