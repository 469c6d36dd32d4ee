"""Maps, footprints and compiled collision checks."""

from up_samp.geometry.atlas import lay_out
from up_samp.geometry.maps import OccupancyGrid, load_map, write_map
from up_samp.geometry.scene import Scene
from up_samp.geometry.shapes import Shape, shape_of

__all__ = ["OccupancyGrid", "Scene", "Shape", "lay_out", "load_map", "shape_of", "write_map"]
