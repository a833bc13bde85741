"""An organ: a cyst in a lump of tissue, with one view."""

from racines_data.phantom.anatomy import Anatomy, Structure, Tissue, ViewSpec
from racines_data.phantom.shapes import ellipsoid

TISSUES = (
    Tissue("gel", -15.0, 0.50, 1540.0, 1040.0),
    Tissue("tissue", 0.0, 0.50, 1580.0, 1060.0),
    Tissue("fluid", -55.0, 0.05, 1530.0, 1015.0),
)


def _paint(points):
    tissue = (ellipsoid(points, (0.0, 0.0, 0.0), (0.05, 0.04, 0.03)) < 0).long()
    tissue[ellipsoid(points, (0.0, 0.0, 0.0), (0.01,) * 3) < 0] = 2
    return tissue


def cyst(seed=0):
    return Anatomy(
        name="cyst",
        tissues=TISSUES,
        paint=_paint,
        structures=(Structure("cyst", (0.0, 0.0, 0.0), 0.01),),
        views=(
            ViewSpec("CY", (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, -1.0, 0.0), (("cyst", 1.0),)),
        ),
        axes=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        origin=(0.490, 0.010, 0.005),
    )
